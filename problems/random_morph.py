"""Write a random convex morph for any n as a problem file.

Usage: python problems/random_morph.py ROBOTS SEED > problem.yaml
"""

import sys

from ruamel.yaml import YAML

from hitchopt.mission.random_morph import random_morph

if __name__ == "__main__":
    robots, seed = (int(word) for word in sys.argv[1:3])
    yaml = YAML()  # keeps the keys in their order
    yaml.default_flow_style = None
    yaml.dump(random_morph(robots, seed), sys.stdout)
