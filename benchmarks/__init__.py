"""Timings and profiles; nothing here decides whether a test passes."""

import os

os.environ["HITCHOPT_MEMORY"] = "off"  # what is measured is solved
