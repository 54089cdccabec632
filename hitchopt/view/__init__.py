"""Floor 8: pictures of a plan. Drawing libraries are imported by the modules that draw."""
