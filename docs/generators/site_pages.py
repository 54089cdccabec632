"""All generated pages, and the directories that hold them; ``docs/conf.py`` writes them."""

from __future__ import annotations

from pathlib import Path

from generators.check_facts import write_check_facts
from generators.gallery_page import write_gallery_page
from generators.problem_collection import ROOT
from generators.schema_page import write_schema_page

DOCS = ROOT / "docs"

RESULTS = ROOT / "benchmarks" / "results"


def pages() -> dict[Path, str]:
    """Return the text of all generated pages, by their paths."""
    reference = DOCS / "reference" / "generated"
    texts = {
        reference / "problem_file.md": write_schema_page(),
        DOCS / "gallery" / "index.md": write_gallery_page(),
    }
    for name, text in write_check_facts().items():
        texts[DOCS / "explanation" / "generated" / f"{name}.md"] = text
    for path in sorted(RESULTS.glob("*.md")):
        included = (
            f"```{{include}} ../../../benchmarks/results/{path.name}\n:relative-images:\n```\n"
        )
        texts[DOCS / "benchmarks" / "generated" / path.name] = included
    return texts


def write_pages() -> None:
    """Write the generated pages whose text has changed, so that others are not built anew."""
    for path, text in pages().items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
