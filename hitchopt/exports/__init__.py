"""Floor 8: the files of a plan, written whole or not at all."""
