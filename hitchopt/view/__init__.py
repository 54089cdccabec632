"""Pictures of a plan; its modules import drawing libraries, so import them only when drawing."""
