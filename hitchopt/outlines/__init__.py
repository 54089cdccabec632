"""Outlines of objects, read from drawings. It knows no hitch."""
