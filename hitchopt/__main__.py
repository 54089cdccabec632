"""``python -m hitchopt`` is ``hitchopt``."""

from hitchopt.cli import main

if __name__ == "__main__":
    main(prog_name="hitchopt")
