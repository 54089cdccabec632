"""Friction at the clasps: where it leaves vertices, and over-travels that remove it."""
