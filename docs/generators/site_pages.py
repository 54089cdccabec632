"""All generated pages; ``docs/conf.py`` writes them."""

from __future__ import annotations

from generators.check_facts import write_check_page, write_check_table
from generators.drone_lists import write_checklist, write_model_table
from generators.gallery_page import write_gallery
from generators.problem_collection import ROOT
from generators.schema_page import write_schema_page
from generators.script_page import write_script_page
from generators.steps_page import write_steps_page
from generators.support_page import write_support_page

DOCS = ROOT / "docs"


def write_pages() -> None:
    """Write generated pages whose text has changed, so that others are not rebuilt."""
    texts = {DOCS / "reference/generated/problem_file.md": write_schema_page(), **write_gallery()}
    texts[DOCS / "reference/generated/formulas.md"] = write_check_page()
    texts[DOCS / "reference/generated/checks.inc"] = write_check_table()
    texts[DOCS / "reference/generated/steps.md"] = write_steps_page()
    texts[DOCS / "reference/generated/what_works_with_what.md"] = write_support_page()
    texts[DOCS / "how_to/generated/scripts.md"] = write_script_page()
    texts[DOCS / "how_to/generated/models.inc"] = write_model_table()
    texts[DOCS / "how_to/generated/checklist.inc"] = write_checklist()
    for path, text in texts.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
