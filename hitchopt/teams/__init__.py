"""Several teams in one airspace: their start times, and distances between them."""
