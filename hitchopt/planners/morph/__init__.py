"""Morphs: paths of a hitch, leg lengths along them, and the paper's actions."""
