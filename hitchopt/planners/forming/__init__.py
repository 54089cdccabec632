"""Planners that form a hitch in midair and take it apart again: the paper's Action 1."""
