"""The lab: simulations and recordings of plans, built on the core, which imports nothing of it."""
