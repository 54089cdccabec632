"""Single drones: curves out of each other's downwash, by convex QPs, and their step."""
