"""What holds for all tests: no cache of the user's, and property tests that depend on no clock."""

import os

from hypothesis import settings

# No test reads or leaves models in the user's cache, or gets what another one has planned.
os.environ["HITCHOPT_CACHE"] = "off"
os.environ["HITCHOPT_MEMORY"] = "off"

# A busy machine is no failure, and every run tries the same examples.
settings.register_profile("hitchopt", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("hitchopt")
