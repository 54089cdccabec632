"""The lab: studies of plans, standing on the core, which imports nothing of it."""
