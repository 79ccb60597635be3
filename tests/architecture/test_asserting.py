"""Every test can fail: it asserts something that is no constant, expects an error, or calls a helper that does.

A test that only runs code finds crashes and nothing else; one of an earlier version that compared literals with
literals could not even do that. Helpers are followed by name: functions of the same file, of a ``conftest.py`` above
it, and of files under ``tests/`` that it imports or loads.
"""

import ast
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
FILES = sorted(TESTS.rglob("test_*.py"))

EXPECTING = {"raises", "warns", "fail", "check_returncode", "gradcheck", "gradgradcheck"}
"""Calls, besides those that begin with ``assert``, that fail where something is not as it should be."""


def is_constant(node):
    """Whether an expression is made of literals only, and so always true or never."""
    return isinstance(node, ast.Tuple) or not any(
        isinstance(part, ast.Name | ast.Attribute | ast.Call | ast.Await | ast.Yield | ast.NamedExpr)
        for part in ast.walk(node)
    )


def called(node):
    """Last name of what a call calls; None where it has none."""
    function = node.func
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else None


@cache
def checks(function):
    """Whether a function's own text can fail on purpose."""
    for node in ast.walk(function):
        if isinstance(node, ast.Raise):
            return True
        if isinstance(node, ast.Assert) and not is_constant(node.test):
            return True
        if isinstance(node, ast.Call):
            name = called(node) or ""
            if name in EXPECTING or name.startswith("assert"):
                return True
            if any(key.arg == "check" and getattr(key.value, "value", None) is True for key in node.keywords):
                return True
    return False


@cache
def used(function):
    """Names that a function calls or hands on to calls; not its own variables."""
    calls = [node for node in ast.walk(function) if isinstance(node, ast.Call)]
    given = [value for call in calls for value in (*call.args, *(key.value for key in call.keywords))]
    names = {called(call) for call in calls} | {value.id for value in given if isinstance(value, ast.Name)}
    return names - {
        node.id for node in ast.walk(function) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }


def functions(tree):
    """Functions and methods of a file by name, not those inside functions; several may share a name."""
    found = {}
    for node in tree.body:
        for part in node.body if isinstance(node, ast.ClassDef) else [node]:
            if isinstance(part, ast.FunctionDef | ast.AsyncFunctionDef):
                found.setdefault(part.name, []).append(part)
    return found


@cache
def parsed(path):
    return functions(ast.parse(path.read_text(encoding="utf-8")))


@cache
def helpers(path, root=TESTS):
    """Functions that a test of a file may call by name: its own, of conftests above, of helper files."""
    known = {}
    folders = [folder for folder in (path.parent, *path.parent.parents) if folder.is_relative_to(root)]
    beside = [file for folder in folders for file in folder.glob("*.py") if not file.name.startswith("test_")]
    for file in (*beside, path):
        for name, nodes in parsed(file).items():
            known.setdefault(name, []).extend(nodes)
    return known


def silent(path, root=TESTS):
    """Names of the tests of a file that cannot fail but by a crash."""
    known = helpers(path, root)
    speaking = {name for name, nodes in known.items() if any(map(checks, nodes))}
    while True:
        more = {
            name
            for name, nodes in known.items()
            if name not in speaking and any(used(node) & speaking for node in nodes)
        }
        if not more:
            break
        speaking |= more
    return [name for name in parsed(path) if name.startswith("test_") and name not in speaking]


@pytest.mark.parametrize("path", FILES, ids=[str(path.relative_to(TESTS)) for path in FILES])
def test_every_test_can_fail(path):
    assert not silent(path)


@pytest.mark.parametrize(
    ("body", "can_fail"),
    [
        ("f()", False),
        ("assert True", False),
        ("assert 1 + 1 == 2", False),
        ("assert (f(), 'text')", False),
        ("assert f()", True),
        ("with pytest.raises(ValueError): f()", True),
        ("np.testing.assert_allclose(f(), 1)", True),
        ("subprocess.run(['x'], check=True)", True),
        ("subprocess.run(['x'], check=False)", False),
        ("helper(f())", True),
        ("quiet(f())", False),
        ("indirect()", True),
        ("def inner():\n        assert f()\n    inner()", True),
    ],
)
def test_the_check_knows_which(body, can_fail, tmp_path):
    text = "def helper(x):\n    assert x\ndef quiet(x):\n    return x\ndef indirect():\n    helper(1)\n"
    path = tmp_path / "test_x.py"
    path.write_text(f"{text}def test_it():\n    {body}\n", encoding="utf-8")
    assert silent(path, tmp_path) == ([] if can_fail else ["test_it"])


def test_fixtures_and_conftests_count(tmp_path):
    (tmp_path / "conftest.py").write_text("def checked(x):\n    assert x\n", encoding="utf-8")
    (tmp_path / "a").mkdir()
    path = tmp_path / "a" / "test_x.py"
    path.write_text("def test_one(checked):\n    checked(1)\ndef test_two(other):\n    other(1)\n", encoding="utf-8")
    assert silent(path, tmp_path) == ["test_two"]
