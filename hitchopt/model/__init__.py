"""Floor 4: the model: flat outputs (vertices, legs, tensions) to drones, thrusts, residuals."""
