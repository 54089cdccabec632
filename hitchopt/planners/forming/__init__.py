"""How a hitch is formed in midair, and taken apart again: the paper's Action 1."""
