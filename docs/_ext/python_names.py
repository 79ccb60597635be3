"""Names that no Python object has are told by their last part.

Annotations are full of them: float, Tensor, Any. Sphinx goes through all objects for each, which takes as long as
reading the sources.
"""

from typing import Any

from sphinx.application import Sphinx
from sphinx.domains.python import ObjectEntry, PythonDomain
from sphinx.environment import BuildEnvironment


def last_part(name: str) -> str:
    """``field`` of ``module.Class.field``."""
    return name.removesuffix("()").rpartition(".")[2]


class PythonNames(PythonDomain):
    """The domain ``py``; finds what Sphinx's own finds."""

    last_parts: frozenset[str] | None = None
    """Of all objects, from when the last page is read."""

    def find_obj(
        self, env: BuildEnvironment, modname: str, classname: str, name: str, type: str | None, searchmode: int = 0
    ) -> list[tuple[str, ObjectEntry]]:
        # Whatever is found is the name, or ends with a dot and the name.
        if self.last_parts is not None and last_part(name) not in self.last_parts:
            return []
        return super().find_obj(env, modname, classname, name, type, searchmode)


def _collect(app: Sphinx, env: BuildEnvironment) -> None:
    domain: Any = env.domains.python_domain
    domain.last_parts = frozenset(map(last_part, domain.objects))


def setup(app: Sphinx) -> dict[str, bool]:
    """In place of Sphinx's own."""
    app.add_domain(PythonNames, override=True)
    app.connect("env-updated", _collect)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
