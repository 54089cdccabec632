"""Flying a plan's setpoints through a rope simulation (an extra: needs mujoco)."""
