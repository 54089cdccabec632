"""Floor 5: planners; each takes a hitch and limits and gives trajectories."""
