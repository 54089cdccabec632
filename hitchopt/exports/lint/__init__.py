"""Pre-flight lint: fleet files read back, ours or anybody else's, and what would go wrong."""
