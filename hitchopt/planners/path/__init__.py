"""Paths of a hitch in its own parameter, without time."""
