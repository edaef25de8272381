"""What the site needs beside its pages: README as the first one, formulas as MathML, links into the code as words.

Everything is done when the site is built, so that nothing is fetched when it is read.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File

_CODE = re.compile(r"(```.*?```|`[^`\n]*`)", re.DOTALL)  # stays as it is
_DISPLAYED = re.compile(r"\$\$(.+?)\$\$", re.DOTALL)
_INLINE = re.compile(r"(?<![\\$\w])\$(?!\s)([^$\n]+?)(?<!\s)\$(?!\w)")
_OUTSIDE = re.compile(r"\[([^\]]*)\]\((?:\.\./)+(?!docs/)([^)#\s]*)(#[^)]*)?\)")


def on_files(files: Any, config: Any) -> Any:
    """README is the first page."""
    text = (Path(config["config_file_path"]).parent / "README.md").read_text(encoding="utf-8")
    text = re.sub(r"\]\(docs/", "](", text)
    text = re.sub(r'(src|href)="docs/', r'\1="', text)
    text = re.sub(r"\[([^\]]*)\]\((?!https?:|#|images/|[a-z-]+\.md)([^)]*)\)", r"\1 (`\2`)", text)
    files.append(File.generated(config, "index.md", content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Formulas become MathML; what links to a file of the code says its name."""
    markdown = _OUTSIDE.sub(_named, markdown.replace("](../README.md", "](index.md"))
    parts = _CODE.split(markdown)
    return "".join(part if i % 2 else _said(part) for i, part in enumerate(parts))


def _named(link: re.Match[str]) -> str:
    """The words of a link to a file of the code, with its name where they are not its name."""
    words, file = link.group(1), link.group(2)
    return words if words.strip("`").endswith(file) else f"{words} ({file})"


def _said(text: str) -> str:
    text = _DISPLAYED.sub(lambda found: "\n\n" + convert(found.group(1).strip(), display="block") + "\n\n", text)
    # Within a span, as a line that begins with a formula would else be a block of its own.
    return _INLINE.sub(lambda found: f"<span>{convert(found.group(1))}</span>", text)
