"""No test reads or leaves models in the user's cache, or gets what another one has planned."""

import os

os.environ["HITCHOPT_CACHE"] = "off"
os.environ["HITCHOPT_MEMORY"] = "off"
