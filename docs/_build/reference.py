"""The pages of the API reference, found in the source without importing it.

A package has a page when it exports names or holds public modules, and a module is public when it has an `__all__`: new
ones turn up by themselves. The pages only name what they document (`::: name`): mkdocstrings does the rest.
"""

from __future__ import annotations

import ast
import posixpath
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

__all__ = ["INTERNAL", "PACKAGES", "Module", "Page", "nav_of", "overview", "pages"]

PACKAGES = ("shield", "mpc", "dynamics", "evaluation")

INTERNAL = frozenset(
    {
        "shield.batch",
        "shield.certificate.road",
        "shield.wrappers",
        "shield.certificate.simulated.closest",
        "shield.certificate.simulated.decision_kernels",
        "shield.filters.speed_recovery",
        "shield.filters.simulated.meta_actions",
        "shield.filters.simulated.inputs",
        "shield.filters.simulated.predicted_scene",
        "shield.filters.input_frames",
        "shield.filters.network",
        "shield.certificate.network",
        "shield.filters.simulated.multi_agent",
        "shield.compiling",
        "shield.wrappers.warm_filters",
        "shield.wrappers.warm_parts",
        "shield.wrappers.filter_choice",
        "shield.certificate.simulated.input_verification",
        "shield.certificate.simulated.step_kernels",
        "shield.perception.environment_free",
        "shield.perception.grid_perception",
        "shield.perception.grid_sighting",
        "shield.perception.scenes",
        "shield.perception.sighting",
        "shield.perception.unwrapping",
        "shield.supported_environments",
        "shield.certificate.simulated.workspace",
        "shield.certificate.simulated.search",
        "shield.certificate.simulated.traffic",
        "shield.pipelines",
        "shield.alternatives",
        "shield.rule_kernels",
        "mpc.filter.program",
        "mpc.filter.solvers",
        "dynamics.compiled",
        "dynamics.packages",
        "dynamics.road_networks.simulation.ego_manoeuvres",
        "dynamics.road_networks.reachable.continuations",
        "dynamics.road_networks.traffic.driving",
        "dynamics.road_networks.simulation.frame_kernels",
        "dynamics.road_networks.traffic.constant_inputs",
        "dynamics.road_networks.simulation.kinematics",
        "dynamics.road_networks.geometry.lanes",
        "dynamics.road_networks.geometry.layout",
        "dynamics.road_networks.simulation.live",
        "dynamics.road_networks.geometry.network",
        "dynamics.road_networks.geometry.points",
        "dynamics.road_networks.simulation.supported_traffic",
        "dynamics.road_networks.reachable.rights",
        "dynamics.road_networks.geometry.routes",
        "dynamics.slices",
        "dynamics.highway_simulator.arithmetic",
        "dynamics.highway_simulator.collisions",
        "dynamics.highway_simulator.control",
        "dynamics.highway_simulator.grid",
        "dynamics.highway_simulator.kinds",
        "dynamics.highway_simulator.lanes",
        "dynamics.highway_simulator.loops",
        "dynamics.highway_simulator.motion",
        "dynamics.highway_simulator.neighbours",
        "dynamics.highway_simulator.observe",
        "dynamics.highway_simulator.random",
        "dynamics.highway_simulator.supported_configs",
        "dynamics.highway_simulator.scene",
        "dynamics.highway_simulator.traffic",
        "dynamics.traffic.occupancy_kernels",
        "dynamics.vehicle.rollout_kernels",
        "evaluation.commands",
        "evaluation.running.counting",
        "evaluation.running.processes",
        "evaluation.scenarios.frames",
        "dynamics.road_networks.reachable.prediction",
        "dynamics.road_networks.traffic.priority_road",
        "dynamics.road_networks.reachable.present_lanes",
        "dynamics.road_networks.reachable.strips",
        "evaluation.scenarios.traffic",
        "evaluation.scenarios.wide_network",
        "evaluation.threads",
        "evaluation.wrappers.checks",
    }
)
"""Packages and modules that only their neighbours use: they have no page."""

_HANDED_OUT = {"shield": ("shield.wrappers.report.Statistics",)}
"""What a package's names return, and the package itself does not export."""

_OVERVIEW = "reference/index.md"

_Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Module:
    """A module or a package, as its source says it is.

    Attributes
    ----------
    name : its dotted name.
    path : its file.
    """

    name: str
    path: Path

    @cached_property
    def tree(self) -> ast.Module:
        """The parsed source."""
        return ast.parse(self.path.read_text(encoding="utf-8"))

    @cached_property
    def lead(self) -> str:
        """The first paragraph of its docstring."""
        return _lead(self.tree)

    @cached_property
    def exported(self) -> tuple[str, ...]:
        """Its `__all__`."""
        for node in self.tree.body:
            if isinstance(node, ast.Assign) and any(
                isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets
            ):
                return tuple(ast.literal_eval(node.value))
        return ()

    @cached_property
    def imported(self) -> dict[str, str]:
        """The module that each imported name comes from, also of imports for type checkers only: packages are lazy."""
        nodes = (node for node in ast.walk(self.tree) if isinstance(node, ast.ImportFrom) and node.module)
        return {alias.name: str(node.module) for node in nodes for alias in node.names}

    @property
    def shown(self) -> tuple[str, ...]:
        """What it exports, but for what comes from its own top-level package and is shown there."""
        own = self.name.partition(".")[0]
        return tuple(n for n in self.exported if self.imported.get(n, "").partition(".")[0] != own)


@dataclass(frozen=True)
class Page:
    """A page of the reference.

    Attributes
    ----------
    package : the package that it is about.
    uri : its place in the site.
    lead : what the package is, in a sentence or two.
    markdown : all of the page.
    """

    package: str
    uri: str
    lead: str
    markdown: str


def pages(root: Path) -> list[Page]:
    """The page of each package under `root`; packages come before those that they contain."""
    found = [package for name in PACKAGES for package in _packages(root, name)]
    full = [p.name for p in found if p.exported or _modules(p)]
    # One without anything of its own still leads to those that it contains.
    listed = {p.name: p for p in found if any(f"{name}.".startswith(f"{p.name}.") for name in full)}
    uris = {name: _uri(name, any(other.startswith(f"{name}.") for other in listed)) for name in listed}
    out = []
    for name, package in listed.items():
        folder = posixpath.dirname(uris[name])
        inner = {posixpath.relpath(uris[n], folder): m for n, m in listed.items() if n.rpartition(".")[0] == name}
        out.append(Page(name, uris[name], package.lead, _markdown(root, package, inner)))
    return out


def overview(pages: list[Page]) -> str:
    """The first page of the reference."""
    rows = [f"| [{p.package}]({posixpath.relpath(p.uri, 'reference')}) | {p.lead} |" for p in pages]
    return "\n".join(["# API reference", "", "| package | what it holds |", "| :-- | :-- |", *rows, ""])


def nav_of(pages: list[Page], parent: str = "") -> list[object]:
    """The reference's part of the navigation, as mkdocs wants it."""
    nav: list[object] = [] if parent else [_OVERVIEW]
    for page in pages:
        above, _, name = page.package.rpartition(".")
        if above == parent:
            below = nav_of(pages, page.package)
            nav.append({name: [page.uri, *below] if below else page.uri})
    return nav


def _packages(root: Path, name: str) -> Iterator[Module]:
    """A package and the public ones in it."""
    folder = root.joinpath(*name.split("."))
    yield Module(name, folder / "__init__.py")
    for init in sorted(folder.glob("*/__init__.py")):
        inner = f"{name}.{init.parent.name}"
        if not _internal(inner):
            yield from _packages(root, inner)


def _modules(package: Module) -> list[Module]:
    """The public modules of a package, without those of the packages in it."""
    files = sorted(f for f in package.path.parent.glob("*.py") if f.name != "__init__.py")
    modules = (Module(f"{package.name}.{f.stem}", f) for f in files)
    return [m for m in modules if m.shown and not _internal(m.name)]


def _markdown(root: Path, package: Module, inner: dict[str, Module]) -> str:
    homes = {n: _home(root, package, n) for n in package.exported if n in package.imported}
    direct = [n for n in package.exported if n not in homes or _internal(homes[n].name)]
    parts = [f"# {package.name}", package.lead]
    if inner:
        parts.append("\n".join(f"- [{module.name}]({uri}): {module.lead}" for uri, module in inner.items()))
    if homes:
        rows = [f"| [{n}][{home.name}.{n}] | {_summary(root, home, n)} |" for n, home in homes.items()]
        parts += [f"`from {package.name} import …`:", "\n".join(["| name | what it is |", "| :-- | :-- |", *rows])]
    parts += [f"::: {package.name}.{name}" for name in direct]
    parts += [f"::: {name}" for name in _HANDED_OUT.get(package.name, ())]
    parts += [_section(module) for module in _modules(package)]
    return "\n\n".join(parts) + "\n"


def _section(module: Module) -> str:
    members = "".join(f'\n        - "{name}"' for name in module.shown)
    return f"::: {module.name}\n    options:\n      members:{members}"


def _home(root: Path, package: Module, name: str) -> Module:
    """The module that a package takes a name from."""
    module = package.imported[name]
    folder = root.joinpath(*module.split("."))
    return Module(module, folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py"))


def _summary(root: Path, module: Module, name: str) -> str:
    """The first paragraph of the docstring of a class or a function, wherever it was imported from."""
    while name in module.imported:
        module = _home(root, module, name)
    found = (n for n in module.tree.body if isinstance(n, _Documented) and getattr(n, "name", None) == name)
    return next((_lead(node) for node in found), "")


def _uri(name: str, section: bool) -> str:
    return f"reference/{name.replace('.', '/')}{'/index' if section else ''}.md"


def _internal(name: str) -> bool:
    return any(f"{name}.".startswith(f"{internal}.") for internal in INTERNAL)


def _lead(node: _Documented) -> str:
    return " ".join((ast.get_docstring(node) or "").split("\n\n")[0].split())
