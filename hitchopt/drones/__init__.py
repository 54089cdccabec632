"""Drones one by one: their kinds, position loops, and the parameters of their firmware.

Teams, cables and hitches are in ``hitch``; laws of motors and filters in ``lab/simulation``.
"""
