"""The page of the scripts to copy, which executes them and shows what they print."""

from __future__ import annotations

from generators.problem_collection import PROBLEMS

SCRIPTS = sorted((PROBLEMS / "scripts").glob("*.py"))

HEAD = """---
file_format: mystnb
kernelspec:
  name: python3
---

# Scripts to copy

Short programs of one idea each, in `problems/scripts/`. They are executed when the documentation is built, and assert what
they print.
"""

SECTION = """
(script-{name})=
## {title}

```{{literalinclude}} ../../../problems/scripts/{name}.py
:language: python
```

```{{code-cell}} python
:tags: [remove-input]

%script {name}
```
"""


def write_script_page() -> str:
    """Return the page."""
    titles = {file.stem: file.stem.replace("_", " ").capitalize() for file in SCRIPTS}
    return HEAD + "".join(SECTION.format(name=name, title=title) for name, title in titles.items())
