"""Which file imports which, read from the source."""

import ast
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("warp_caustics", "data_gen", "nets", "cli")


@dataclass(frozen=True)
class Arrow:
    """One file imports another; how: ``at the top``, ``in a function`` or ``for types``."""

    source: str
    target: str
    how: str

    def __str__(self):
        return f"{self.source} -> {self.target} ({self.how})"


def module_name(path, root=ROOT):
    """Dotted name of a file; a package's is that of its ``__init__.py``."""
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def modules(*packages, root=ROOT):
    """Path of every module of packages, by its dotted name."""
    return {module_name(path, root): path for package in packages for path in sorted((root / package).rglob("*.py"))}


@cache
def imports(source):
    """Imported modules and names of a file's source, each with how it is imported."""
    return tuple(_imports(ast.parse(source), "at the top"))


def _imports(node, how):
    if isinstance(node, ast.Import):
        yield from ((alias.name, None, how) for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        assert node.level == 0, "relative import"
        yield from ((node.module, alias.name, how) for alias in node.names)
    elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        for part in node.body:
            yield from _imports(part, "for types")
        for part in node.orelse:
            yield from _imports(part, how)
    elif not isinstance(node, ast.expr):  # an expression holds no statement
        inside = "in a function" if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) else how
        for part in ast.iter_child_nodes(node):
            yield from _imports(part, inside)


def arrows(files):
    """Every import of one of these files by another; ``files``: path by dotted name."""
    for source, path in files.items():
        for module, name, how in imports(path.read_text(encoding="utf-8")):
            target = f"{module}.{name}" if f"{module}.{name}" in files else module
            if target in files and target != source:
                yield Arrow(source, target, how)


def circles(pairs):
    """Groups of names that lead back to themselves (strongly connected components, Tarjan 1972).

    Args:
        pairs: (source, target) of every arrow.
    """
    graph = {}
    for source, target in pairs:
        graph.setdefault(source, set()).add(target)
    number, lowest, stack, found = {}, {}, [], set()

    def visit(name):
        number[name] = lowest[name] = len(number)
        stack.append(name)
        for target in sorted(graph.get(name, ())):
            if target not in number:
                visit(target)
            if target in stack:
                lowest[name] = min(lowest[name], lowest[target])
        if lowest[name] == number[name]:
            group = frozenset(stack[stack.index(name) :])
            del stack[stack.index(name) :]
            if len(group) > 1:
                found.add(group)

    for name in sorted(graph):
        if name not in number:
            visit(name)
    return found
