"""How a hitch holds an object: wrapped edges, balance at clasps, and what is held at most.

It knows no time.
"""
