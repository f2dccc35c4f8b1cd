"""Lay out the pages of the documentation site: README and docs/, with links that work there.

    python -m tools.stage_docs FOLDER

In the repository, links lead to any file of it. The site has only pages and pictures: a link to another file becomes
that file's path.
"""

from __future__ import annotations

import re
import shutil
import sys
from os.path import relpath
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
ELSEWHERE = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "benchmarks.md",
    "packages/autoexpose-client/README.md": "autoexpose-client.md",
    "packages/camera-twin/README.md": "camera-twin.md",
}
"""Pages outside docs/, and what they are called on the site."""

_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#]*)(#[^)\s]*)?\)")
_FENCE = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)


def places(repository: Path) -> dict[Path, Path]:
    """Where each page and picture of the repository is on the site, as relative paths."""
    docs = [path for path in sorted((repository / "docs").rglob("*")) if path.is_file()]
    found = {path.relative_to(repository): path.relative_to(repository / "docs") for path in docs}
    # The site's server and its search know a folder's page by this name.
    found = {
        source: place.with_name("index.md") if place.name == "README.md" else place for source, place in found.items()
    }
    return found | {Path(source): Path(place) for source, place in ELSEWHERE.items()}


def with_links(text: str, source: Path, at: dict[Path, Path]) -> str:
    """The text of a page, with its links as the site needs them; code blocks stay as they are."""

    def replaced(link: re.Match[str]) -> str:
        picture, words, target, anchor = link.groups(default="")
        if not target or ":" in target:
            return link[0]
        path = Path(relpath(REPOSITORY / source.parent / target, REPOSITORY))
        page = path / "README.md" if path / "README.md" in at else path
        if page in at:
            return f"{picture}[{words}]({relpath(at[page], at[source].parent)}{anchor})"
        if not (REPOSITORY / path).exists():
            raise SystemExit(f"{source}: links to {target}, which does not exist")
        return f"`{path}`" if words.strip("`") in str(path) else f"{words} (`{path}`)"

    parts = _FENCE.split(text)
    return "".join(part if part.startswith("```") else _LINK.sub(replaced, part) for part in parts)


def stage(folder: Path) -> None:
    """Lay out all pages in a folder, which is replaced."""
    shutil.rmtree(folder, ignore_errors=True)
    at = places(REPOSITORY)
    for source, place in at.items():
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        if source.suffix == ".md":
            (folder / place).write_text(with_links((REPOSITORY / source).read_text(), source, at))
        else:
            shutil.copyfile(REPOSITORY / source, folder / place)


if __name__ == "__main__":
    stage(Path(sys.argv[1]))
