"""Notebooks of the documentation: run their cells and keep what they show.

    python -m tests.notebook docs/tutorials/ten-things.ipynb --write

runs a notebook and writes the outputs into it. Cells run in one namespace, in a folder of their own, and the last
expression of a cell is shown, as in Jupyter. No kernel is needed.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

_RICH = {"text/html": "_repr_html_", "image/svg+xml": "_repr_svg_"}


def code_of(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the cells with code."""
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def executed(notebook: dict[str, Any]) -> list[list[dict[str, Any]]]:
    """Run the cells of a notebook; return the outputs of each."""
    names: dict[str, Any] = {"__name__": "__main__"}
    return [
        _outputs("".join(cell["source"]), names, count) for count, cell in enumerate(code_of(notebook), 1)
    ]


def _outputs(source: str, names: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """Run a cell, and return what Jupyter would show below it."""
    tree = ast.parse(source)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    printed, value = io.StringIO(), None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, f"cell {count}", "exec"), names)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), f"cell {count}", "eval"), names)
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        outputs.append({"output_type": "stream", "name": "stdout", "text": _lines(printed.getvalue())})
    if value is not None:
        rich = {kind: _lines(getattr(value, name)()) for kind, name in _RICH.items() if hasattr(value, name)}
        data = {"text/plain": _lines(repr(value)), **rich}
        outputs.append(
            {"output_type": "execute_result", "execution_count": count, "metadata": {}, "data": data}
        )
    return outputs


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def plain(outputs: list[dict[str, Any]]) -> str:
    """Return the text of outputs, without pictures and tables."""
    return "\n".join("".join(one["text"] if "text" in one else one["data"]["text/plain"]) for one in outputs)


def main(path: Path) -> None:
    """Run a notebook, and write the outputs into it."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            found = executed(notebook)
        finally:
            os.chdir(before)
    for count, (cell, outputs) in enumerate(zip(code_of(notebook), found, strict=True), 1):
        cell |= {"outputs": outputs, "execution_count": count}
        print(plain(outputs))
    path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 3 or sys.argv[2] != "--write":
        sys.exit(__doc__)
    main(Path(sys.argv[1]).resolve())
