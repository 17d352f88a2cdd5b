"""Kernel files are checked by mypy with a lighter hand; what of them runs on the host is fully annotated even so."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

FILES = sorted((Path(__file__).parents[2] / "kernels").glob("*.py"))


def runs_in_taichi(function: ast.FunctionDef) -> bool:
    """Whether a function is decorated as a Taichi kernel or function."""
    return any(ast.unparse(d).removeprefix("ti.") in ("kernel", "func") for d in function.decorator_list)


def unannotated(tree: ast.AST) -> list[str]:
    """What lacks an annotation in the functions that run on the host: ``function`` or ``function.argument``."""
    missing = []
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef) or runs_in_taichi(function):
            continue
        arguments = function.args
        given = (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, arguments.vararg, arguments.kwarg)
        missing += [
            f"{function.name}.{argument.arg}"
            for argument in given
            if argument is not None and argument.annotation is None and argument.arg not in ("self", "cls")
        ]
        if function.returns is None:
            missing.append(function.name)
    return missing


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_host_functions_of_the_kernels_are_annotated(file: Path):
    assert unannotated(ast.parse(file.read_text(encoding="utf-8"))) == []


def test_the_check_finds_what_is_missing():
    code = "@kernel\ndef a(x): ...\n@ti.func\ndef aa(x): ...\ndef b(x, y: int): ...\ndef c() -> int: ...\n"
    assert unannotated(ast.parse(code)) == ["b.x", "b"]
