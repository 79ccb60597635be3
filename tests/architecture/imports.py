"""Which file imports which, read from the source."""

import ast
from dataclasses import dataclass
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


def imports(source):
    """Imported modules and names of a file's source, each with how it is imported."""
    tree = ast.parse(source)
    how = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            how |= {id(inner): "for types" for child in node.body for inner in ast.walk(child)}
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            how |= {id(inner): "in a function" for inner in ast.walk(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, None, how.get(id(node), "at the top")
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            for alias in node.names:
                yield node.module, alias.name, how.get(id(node), "at the top")


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
