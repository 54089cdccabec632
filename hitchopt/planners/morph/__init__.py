"""Morphs: paths of a hitch in its own parameter, its legs on them, and the paper's actions."""
