"""Corrections of a plan in flight by measured vertices."""
