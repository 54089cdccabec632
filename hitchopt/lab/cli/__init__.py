"""Commands of the lab; ``hitchopt.cli`` names their modules and imports them on demand."""
