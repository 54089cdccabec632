"""Formats of fleets and scripts: one file each, behind the protocol in ``format``."""
