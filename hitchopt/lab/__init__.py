"""The lab: studies of plans, built on the core, which imports nothing from it."""
