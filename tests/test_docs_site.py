"""The documentation site has every page and every public name, and loads nothing from elsewhere."""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
MKDOCS = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
PACKAGES = ("shield", "mpc", "dynamics", "evaluation")


def load(name: str) -> ModuleType:
    """A module of docs/_build, which is no package."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / "_build" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


reference = load("reference")


def documented(root: Path) -> set[str]:
    """The full names that the reference shows, as its pages name them to mkdocstrings."""
    names: set[str] = set()
    for page in reference.pages(root):
        for block in re.findall(r"^::: .*(?:\n .*)*", page.markdown, re.MULTILINE):
            name = block.split()[1]
            names |= {f"{name}.{member}" for member in re.findall(r"- \"(\w+)\"", block)} or {name}
    return names


@pytest.fixture(scope="module")
def shown() -> set[str]:
    return documented(ROOT)


def exported(path: Path) -> list[str]:
    found = re.search(r"^__all__ = (\[.*?\])", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return ast.literal_eval(found[1]) if found else []


def origin(package: str, name: str) -> Path:
    """The file that defines a name which a package exports."""
    path = ROOT / package / "__init__.py"
    names = rf"^ *from (\S+) import (?:\([^)]*|.*)\b{name}\b"
    while source := re.search(names, path.read_text(encoding="utf-8"), re.MULTILINE):
        module = ROOT / source[1].replace(".", "/")
        path = module / "__init__.py" if module.is_dir() else module.with_suffix(".py")
    return path


EXPORTED = [
    (package, name) for package in ("shield", "mpc", "evaluation") for name in exported(ROOT / package / "__init__.py")
]


@pytest.mark.parametrize(("package", "name"), EXPORTED)
def test_every_export_of_a_package_has_a_docstring_and_is_in_the_reference(
    package: str, name: str, shown: set[str]
) -> None:
    path = origin(package, name)
    (node,) = (n for n in ast.parse(path.read_text(encoding="utf-8")).body if getattr(n, "name", None) == name)
    assert ast.get_docstring(node)
    home = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    assert shown & {f"{package}.{name}", f"{home}.{name}"}


def test_the_names_that_the_reference_is_about_are_many(shown: set[str]) -> None:
    assert len(EXPORTED) >= 24
    assert len(shown) >= 200


def test_every_module_with_public_names_is_in_the_reference_or_declared_internal(shown: set[str]) -> None:
    modules = {name.rpartition(".")[0] for name in shown}
    for path in (file for package in PACKAGES for file in (ROOT / package).rglob("*.py")):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        internal = any(f"{module}.".startswith(f"{name}.") for name in reference.INTERNAL)
        if path.name != "__init__.py" and exported(path):
            assert internal or module in modules, module


def test_modules_declared_internal_exist() -> None:
    for name in reference.INTERNAL:
        path = ROOT / name.replace(".", "/")
        assert path.is_dir() or path.with_suffix(".py").is_file(), name


def test_new_modules_appear_in_the_reference_automatically(tmp_path: Path) -> None:
    for package in PACKAGES:
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text(f'"""About {package}."""\n', encoding="utf-8")
    assert documented(tmp_path) == set()
    (tmp_path / "mpc" / "brakes").mkdir()
    (tmp_path / "mpc" / "brakes" / "__init__.py").write_text('"""How to stop."""\n', encoding="utf-8")
    (tmp_path / "mpc" / "brakes" / "hard.py").write_text('__all__ = ["stop"]\n', encoding="utf-8")
    (tmp_path / "mpc" / "brakes" / "_soft.py").write_text("slow = 1\n", encoding="utf-8")
    assert documented(tmp_path) == {"mpc.brakes.hard.stop"}
    pages = reference.pages(tmp_path)
    assert [page.lead for page in pages] == ["About mpc.", "How to stop."]
    assert reference.nav_of(pages) == [
        "reference/index.md",
        {"mpc": ["reference/mpc/index.md", {"brakes": "reference/mpc/brakes.md"}]},
    ]


def listed() -> list[str]:
    """The pages that mkdocs.yml lists, in order: pages of docs/, index.md for the README, and source/FILE.md for
    other files."""
    nav = re.search(r"^nav:\n((?: .*\n)+)", MKDOCS, re.MULTILINE)
    assert nav is not None
    assert "reference/\n" in nav[1]
    return re.findall(r"[\w/-]+\.md", nav[1])


def navigation() -> list[str]:
    """The pages of docs/ among them."""
    return [page for page in listed() if page != "index.md" and not page.startswith("source/")]


def test_every_page_is_in_the_navigation_or_the_lab() -> None:
    pages = {page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md")}
    assert len(listed()) == len(set(listed()))
    assert set(navigation()) == {page for page in pages if not page.startswith("lab/")}


command_line = load("command_line")


def test_the_page_of_commands_names_every_command() -> None:
    text = (DOCS / "reference" / "cli.md").read_text(encoding="utf-8")
    assert len(command_line.commands()) >= 28
    for name in command_line.commands():
        assert re.search(rf"(^|`){name}\b", text, re.MULTILINE), name


def test_the_site_lists_every_option_of_every_command() -> None:
    sections = re.split(r"^### ", command_line.options(), flags=re.MULTILINE)[1:]
    assert [section.splitlines()[0] for section in sections] == list(command_line.commands())
    for section, command in zip(sections, command_line.commands().values(), strict=True):
        for parameter in (each for each in command.params if not getattr(each, "hidden", False)):
            rows = [line for line in section.splitlines() if line.startswith("| `")]
            assert sum(parameter.name.upper() in row or parameter.opts[0] in row for row in rows) >= 1, parameter.name


EXPLANATIONS = (
    "how-it-decides",
    "roads",
    "simulated-traffic",
    "perception",
    "simulator",
    "predictive-filter",
    "learned-dynamics",
)


def words(page: Path) -> int:
    """Words of a page, its tables and code blocks included, without comments and link targets."""
    text = re.sub(r"<!--.*?-->", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return sum(bool(re.search(r"\w", word)) for word in re.sub(r"\]\([^)\s]*\)", "]", text).split())


def test_the_navigation_has_at_most_15000_words() -> None:
    """A newcomer can finish the navigation; experiments and measurements are on pages in docs/lab."""
    pages = {"README.md": ROOT / "README.md"} | {page: DOCS / page for page in navigation()}
    pages |= {page: ROOT / page[len("source/") :] for page in listed() if re.fullmatch(r"source/\w+\.md", page)}
    counts = {name: words(page) for name, page in pages.items()}
    assert sum(counts.values()) <= 15_000, counts


@pytest.mark.parametrize("name", EXPLANATIONS)
def test_an_explanation_is_short_has_a_figure_and_ends_with_its_lab_page(name: str) -> None:
    page = DOCS / f"{name}.md"
    assert words(page) <= 1_500
    text = page.read_text(encoding="utf-8")
    assert re.search(r"^!\[.+\]\(images/\S+\.png\)$", text, re.MULTILINE)
    assert f"(lab/{name}.md)" in text[-400:]


@pytest.mark.parametrize("page", sorted((DOCS / "how-to").glob("*.md")), ids=lambda page: page.stem)
def test_a_how_to_has_at_most_500_words(page: Path) -> None:
    assert words(page) <= 500


def measured() -> list[tuple[str, str]]:
    """Tables with intervals on the pages of the navigation, and on the lab pages of the full tables: the page, and all
    that stands before the table on it."""
    found = []
    for page in [*navigation(), "lab/results.md", "lab/what-it-drives.md"]:
        text = (DOCS / page).read_text(encoding="utf-8")
        for table in re.finditer(r"(?:^\|.*\n)+", text, re.MULTILINE):
            if re.search(r"\[\d[\d.]*, \d[\d.]*\]", table[0]):
                found.append((page, text[: table.start()]))
    return found


def test_a_measured_table_names_its_revision_and_its_command() -> None:
    tables = measured()
    assert len(tables) >= 8
    for page, before in tables:
        assert re.search(r"[Rr]evisions? [0-9a-f]{7}\b", before), page
        assert re.search(r"\b(?:shield [a-z]+|python \S+) ", before[-1500:]), page


LAB = sorted((DOCS / "lab").glob("*.md"))


@pytest.mark.parametrize("page", LAB, ids=lambda page: page.stem)
def test_a_lab_page_is_dated_below_its_title(page: Path) -> None:
    title, _, note, *_ = page.read_text(encoding="utf-8").splitlines()
    assert title.startswith("# ")
    assert re.match(r"\*Lab notes, 20\d\d-\d\d\b", note), note


def test_the_extras_docs_and_minari_are_part_of_dev() -> None:
    """On a fresh machine no test of either is skipped."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert {*extras["docs"], *extras["minari"]} <= set(extras["dev"])


def test_the_site_loads_nothing_from_elsewhere() -> None:
    assert "http" not in MKDOCS
    assert re.search(r"^  font: false$", MKDOCS, re.MULTILINE), "the theme's fonts are on another server"
    # Without one of that name the plugin `offline` takes the worker of the search from a server.
    (worker,) = re.findall(r"^ +- (\S*iframe-worker\S*)$", MKDOCS, re.MULTILINE)
    assert (DOCS / worker).is_file()


DOCSTRING = """Brake.

>>> 1 + 1
2

Parameters
----------
speeds, ways : of each vehicle, (n,)
    [m/s] and [m]. dt : of a frame [s].
low : at most
this: that.

Returns
-------
What is left: a share.

    in a block

Raises
------
ConfigError
    If `dt` is 0.
"""


def test_descriptions_are_not_rendered_as_types() -> None:
    griffe = pytest.importorskip("griffe", reason="the extra docs is not installed")
    rewritten = load("docstrings").rewritten(DOCSTRING)
    signature = griffe.Parameters(
        *(griffe.Parameter(name, annotation="float") for name in ("speeds", "ways", "dt", "low"))
    )
    function = griffe.Function("brake", parameters=signature, returns="Rest")
    text, parameters, returns, raises = griffe.Docstring(rewritten, parent=function).parse("numpy")
    assert "```pycon\n>>> 1 + 1\n2\n```" in text.value
    assert {p.name: p.description for p in parameters.value} == {
        "speeds": "of each vehicle, (n,)\n[m/s] and [m].",
        "ways": "of each vehicle, (n,)\n[m/s] and [m].",
        "dt": "of a frame [s].",
        "low": "at most\nthis: that.",
    }
    assert {p.annotation for p in parameters.value} == {"float"}
    (returned,) = returns.value
    assert (returned.name, returned.annotation) == ("", "Rest")
    assert returned.description.rstrip() == "What is left: a share.\n\n    in a block"
    assert [(str(r.annotation), r.description) for r in raises.value] == [("ConfigError", "If `dt` is 0.")]


@pytest.mark.slow
def test_the_site_is_built_without_warnings(tmp_path: Path) -> None:
    for package in ("mkdocs", "material", "mkdocstrings_handlers.python"):
        pytest.importorskip(package, reason="the extra docs is not installed: make docs")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--config-file", str(ROOT / "mkdocs.yml")]
    done = subprocess.run(
        [*command, "--site-dir", str(tmp_path)],
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    html = (tmp_path / "reference" / "shield" / "index.html").read_text(encoding="utf-8")
    start = html.index('id="shield.Shield"')
    shield = html[start : html.index('id="shield.Shield.', start)]
    plain = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", "", shield))
    assert re.search(r"frames \( ?bool ?, default: True ?\) – whether the frames between two decisions", plain), plain
    assert re.search(r"Raises: .*PolicyError – If policy is none of these", plain), plain
    assert 'href="#shield.config.ShieldConfig"' in shield
    for page in tmp_path.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"https://fonts\.|cdn\.|unpkg\.com", text), page
        assert not re.search(r"<(?:script|link|img|iframe)\b[^>]*https?://", text), page
    assert "ShieldedEnv" in (tmp_path / "search" / "search_index.js").read_text(encoding="utf-8")
