"""Rules of the code that no linter checks."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILES = {str(path.relative_to(ROOT)): path.read_text() for path in (ROOT / "clt").rglob("*.py")}
MAX_POSITIONAL, MAX_LINES = 8, 350
REASON = "# More than eight arguments: "
FUNCTION = ast.FunctionDef | ast.AsyncFunctionDef


def test_there_is_code():
    assert len(FILES) > 300


def test_a_function_takes_at_most_eight_arguments_by_place():
    """Kernels may take more where the reason stands above them."""
    wrong = []
    for name, source in FILES.items():
        lines = source.splitlines()
        for node in ast.walk(ast.parse(source)):
            if not isinstance(node, FUNCTION):
                continue
            taken = [
                each for each in (*node.args.posonlyargs, *node.args.args) if each.arg != "self"
            ]
            first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
            reason = lines[first - 2].startswith(REASON) and len(node.decorator_list) > 0
            if len(taken) > MAX_POSITIONAL and not reason:
                wrong.append(f"{name}:{node.lineno} {node.name}")
    assert wrong == []


def documented_in_interfaces():
    """Names of methods that some interface documents."""
    classes = [
        node
        for source in FILES.values()
        for node in ast.parse(source).body
        if isinstance(node, ast.ClassDef) and "Protocol" in [ast.unparse(b) for b in node.bases]
    ]
    inside = [node for each in classes for node in each.body if isinstance(node, FUNCTION)]
    return {node.name for node in inside if ast.get_docstring(node) is not None}


def test_what_is_public_is_documented():
    """A method of an interface is where the interface (a Protocol) is."""
    interfaces, wrong = documented_in_interfaces(), []
    for name, source in FILES.items():
        tree = ast.parse(source)
        classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
        inside = [node for each in classes for node in each.body if isinstance(node, FUNCTION)]
        for node in (*tree.body, *inside):
            named = isinstance(node, ast.ClassDef | FUNCTION) and not node.name.startswith("_")
            named = named and not (node in inside and node.name in interfaces)
            if named and ast.get_docstring(node) is None:
                wrong.append(f"{name}:{node.lineno} {node.name}")
        if ast.get_docstring(tree) is None:
            wrong.append(name)
    assert wrong == []


def test_no_file_is_long():
    assert [name for name, source in FILES.items() if source.count("\n") > MAX_LINES] == []
