"""The casadi model: from flat outputs (vertices, legs, tensions) to drones and thrusts."""
