"""Fits the documents of the repository into the site of `mkdocs.yml`.

Documents outside `docs` become pages, other files that documents link become files of the site, and
formulas become MathML, which browsers draw without a script.
"""

from __future__ import annotations

import html
import logging
import os
import re
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.pages import Page

LOG: Final = logging.getLogger("mkdocs.hooks.site")  # a warning ends a strict build
ROOT: Final = Path(__file__).parents[1]
PAGES: Final = {
    "README.md": "index.md",
    "ARCHITECTURE.md": "repository/ARCHITECTURE.md",
    "CONTRIBUTING.md": "repository/CONTRIBUTING.md",
    "CHANGELOG.md": "repository/CHANGELOG.md",
    "rust/core/NOTATION.md": "repository/NOTATION.md",
}
SOURCES: Final = {page: source for source, page in PAGES.items()}
LINK: Final = re.compile(r"\]\(([^)#:]+)(#[^)]*)?\)")
# Commands that latex2mathml does not have, and what says the same.
SPELLED: Final = [
    ("\\\n", r"\ "),
    ("{aligned}", "{align*}"),
    (r"\arg\min", r"\operatorname{arg\,min}"),
]
DISPLAYED: Final = re.compile(r"^```math\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# The mark of commands that take minutes, which tests of the documents read, and which is no fence
# for the site.
MINUTES: Final = re.compile(r"^```sh minutes$", re.MULTILINE)
FORMULA: Final = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def source_of(page: str) -> str:
    """Return the path of a page's document in the repository."""
    return SOURCES.get(page, f"docs/{page}")


def target_of(source: str) -> str:
    """Return the path in the site of a file of the repository."""
    if source in PAGES:
        return PAGES[source]
    return source.removeprefix("docs/") if source.startswith("docs/") else f"repository/{source}"


def linked(document: str) -> set[str]:
    """Return the files of the repository that a document links."""
    text = (ROOT / document).read_text(encoding="utf-8")
    folder = PurePosixPath(document).parent
    return {os.path.normpath(folder / link[1]) for link in LINK.finditer(text)}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the documents outside `docs`, and what any document links."""
    documents = {source_of(file.src_uri) for file in files.documentation_pages()} | set(PAGES)
    sources = set(PAGES) | {link for document in documents for link in linked(document)}
    for source in sorted(sources):
        path = ROOT / source
        if path.is_file() and files.get_file_from_path(target_of(source)) is None:
            files.append(File.generated(config, target_of(source), abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links lead to the places of the files in the site, and mark formulas and commands."""
    del config, files
    here = page.file.src_uri
    folder = PurePosixPath(source_of(here)).parent

    def moved(link: re.Match[str]) -> str:
        target = target_of(os.path.normpath(folder / link[1]))
        return f"]({os.path.relpath(target, PurePosixPath(here).parent)}{link[2] or ''})"

    fenced = MINUTES.sub("```sh", DISPLAYED.sub(r"$$\n\1$$", markdown))
    return LINK.sub(moved, fenced)


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Draw formulas with MathML."""
    del config, files

    def drawn(formula: re.Match[str]) -> str:
        display = "block" if formula[1] == "div" else "inline"
        text = re.sub(r"\\tag\{(\w+)\}", r"\\qquad (\\text{\1})", html.unescape(formula[2]))
        for written, known in SPELLED:
            text = text.replace(written, known)
        drawing = str(convert(text, display=display))
        if "\\" in drawing or "<mi>&amp;</mi>" in drawing:
            LOG.warning("%s: latex2mathml cannot draw %s", page.file.src_uri, text)
        return drawing

    return FORMULA.sub(drawn, content)
