"""No test reads or leaves models in the user's cache."""

import os

os.environ["HITCHOPT_CACHE"] = "off"
