"""Hitches for an object: what encloses it, what holds it, and how much of it."""
