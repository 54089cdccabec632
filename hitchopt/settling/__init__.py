"""Statics of a plan's hitch: where drones that give way and their cables come to rest."""
