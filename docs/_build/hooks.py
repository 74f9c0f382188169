"""What mkdocs cannot do by itself: the README as the home page, files outside docs/ as pages, API and command line.

Links are written for the repository. Here they are turned into links of the site, so that both work.
"""

from __future__ import annotations

import ast
import posixpath
import re
from pathlib import Path

from command_line import options
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from reference import nav_of, overview, pages

_LINK = re.compile(r"(?<=\]\()(?!https?:|mailto:|#)([^)#\s]+)(?=[)#])")
_REFERENCE, _SOURCE, _COMMANDS = "reference/", "source/", "reference/cli.md"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the reference where the navigation has its folder."""
    config.nav = _with_reference(config.nav or [], nav_of(pages(_root(config))))
    return config


def _with_reference(nav: list, reference: list) -> list:
    """The navigation, a list of {title: page or list of these}, with the pages of the reference in place of its folder."""
    filled = []
    for item in nav:
        ((title, to),) = item.items()
        filled.append(
            {title: reference if to == _REFERENCE else _with_reference(to, reference) if isinstance(to, list) else to}
        )
    return filled


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not in docs/."""
    root = _root(config)
    readme = (root / "README.md").read_text(encoding="utf-8")
    made = {"index.md": readme}
    reference = pages(root)
    made |= {"reference/index.md": overview(reference)} | {page.uri: page.markdown for page in reference}
    sources = {root / "examples"} | _linked(readme, root, root)
    for file in files.documentation_pages():
        path = root / "docs" / file.src_uri
        sources |= _linked(path.read_text(encoding="utf-8"), path.parent, root)
    for text in [path for path in sources if path.suffix == ".md"]:
        sources |= _linked(text.read_text(encoding="utf-8"), text.parent, root)
    sources |= {file for path in sources if path.is_dir() for file in path.glob("*.py")}
    made |= {_source_uri(path, root): _source_page(path, root) for path in sources - {root / "README.md"}}
    for uri, text in made.items():
        files.append(File.generated(config, uri, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links between files of the repository into links between pages."""
    root, uri = _root(config), page.file.src_uri
    if uri.startswith("lab/"):
        page.meta["search"] = {"boost": 0.5}  # The page that explains is found before the notes behind it.
    if not page.file.generated_by:
        folder = (root / "docs" / uri).parent
    elif uri == "index.md":
        folder = root
        page.meta["hide"] = ["toc"]  # its table of results is wide
    elif _is_text(uri, root):
        folder = (root / uri.removeprefix(_SOURCE)).parent
    else:
        return markdown
    linked = _LINK.sub(lambda match: _site_link(match[1], folder, uri, root), markdown)
    return f"{linked}\n{options()}" if uri == _COMMANDS else linked


def _root(config: MkDocsConfig) -> Path:
    return Path(config.config_file_path).resolve().parent


def _linked(markdown: str, folder: Path, root: Path) -> set[Path]:
    """The files and folders outside docs/ that a text of the repository links to."""
    paths = ((folder / target).resolve() for target in _LINK.findall(markdown))
    return {path for path in paths if path.exists() and not path.is_relative_to(root / "docs")}


def _site_link(target: str, folder: Path, uri: str, root: Path) -> str:
    path = (folder / target).resolve()
    if not path.exists():
        return target
    docs = root / "docs"
    to = path.relative_to(docs).as_posix() if path.is_relative_to(docs) else _source_uri(path, root)
    return posixpath.relpath(to, posixpath.dirname(uri))


def _source_uri(path: Path, root: Path) -> str:
    """Of the page that shows a file or a folder of the repository; a page of Markdown keeps its name."""
    name = path.relative_to(root).as_posix()
    if name == "README.md":
        return "index.md"
    if path.is_dir():
        return f"{_SOURCE}{name}/index.md"
    return f"{_SOURCE}{name}" if path.suffix == ".md" else f"{_SOURCE}{name}.md"


def _is_text(uri: str, root: Path) -> bool:
    """Whether a page is Markdown of the repository outside docs/, such as CONTRIBUTING.md, and no listing of a file."""
    return uri.startswith(_SOURCE) and (root / uri.removeprefix(_SOURCE)).is_file()


def _source_page(path: Path, root: Path) -> str:
    name = path.relative_to(root).as_posix()
    if path.suffix == ".md":
        return path.read_text(encoding="utf-8")
    if path.is_file():
        # What explains a name is found before what uses it.
        rank = "---\nsearch:\n  boost: 0.5\n---\n\n"
        return f"{rank}# {name}\n\n````{path.suffix.removeprefix('.')}\n{path.read_text(encoding='utf-8')}````\n"
    rows = [f"- [{file.name}]({file.name}.md): {_summary(file)}" for file in sorted(path.glob("*.py"))]
    return "\n".join([f"# {name.capitalize()}", "", *rows, ""])


def _summary(file: Path) -> str:
    return (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").split("\n")[0]
