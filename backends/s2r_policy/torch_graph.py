"""What the graph of a TorchScript method says about a policy: widths, and whether it changes a state."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

_PASSES = {
    "aten::unsqueeze", "aten::squeeze", "aten::sub", "aten::add", "aten::mul", "aten::div", "aten::clamp", "aten::clip",
    "aten::to", "aten::contiguous", "aten::tanh", "aten::elu", "aten::relu", "aten::sigmoid", "aten::hardtanh",
    "prim::unchecked_cast",
}  # fmt: skip
"""Definition: operators whose first input and output have equally many columns."""
_LAYERS = {"aten::linear": 1, "aten::lstm": 2, "aten::gru": 2}
"""Definition: operators with weights (outputs, width), and the place of these among the inputs."""


def changes_state(graph: Any) -> bool:
    """Return whether an attribute is set, or a tensor that is an attribute is changed in place."""
    for node in _nodes(graph):
        if node.kind() == "prim::SetAttr":
            return True
        if (
            "!" in node.schema().partition(",")[0]
        ):  # the first argument is changed, as in add_(Tensor(a!) self, …
            value = next(iter(node.inputs()))
            while (made := value.node()).kind().startswith("aten::"):
                value = next(iter(made.inputs()))
            if made.kind() == "prim::GetAttr":
                return True
    return False


def widths(graph: Any, module: Any) -> tuple[int | None, int | None]:
    """Return the numbers in an observation and in an action; None where the graph does not show them clearly."""
    observation = list(graph.inputs())[1:2]
    width = outputs = None
    for node in _nodes(graph):
        if node.kind() in _LAYERS and observation:
            source = _origin(next(iter(node.inputs())))
            if source.debugName() == observation[0].debugName():
                width = _weight(node, module, 1)
                break
    action = next(iter(graph.outputs()), None)
    if action is not None and action.node().kind() == "prim::TupleConstruct":
        action = next(iter(action.node().inputs()))
    if action is not None:
        node = _origin(action).node()
        outputs = _weight(node, module, 0) if node.kind() == "aten::linear" else None
    return width, outputs


def _nodes(block: Any) -> Iterator[Any]:
    """Yield every node of a graph, also in branches."""
    for node in block.nodes():
        yield node
        for inner in node.blocks():
            yield from _nodes(inner)


def _origin(value: Any) -> Any:
    """Return the value from which another is made without a change of its columns."""
    while True:
        node = value.node()
        if node.kind() == "prim::If":
            place = [one.debugName() for one in node.outputs()].index(value.debugName())
            value = list(next(iter(node.blocks())).outputs())[place]
        elif node.kind() in _PASSES:
            value = next(iter(node.inputs()))
        else:
            return value


def _weight(node: Any, module: Any, axis: int) -> int | None:
    """Return a size of a layer's weights; None if they are computed."""
    value = list(node.inputs())[_LAYERS[node.kind()]]
    names: list[str] = []
    while value.node().kind() == "prim::GetAttr":
        names.insert(0, value.node().s("name"))
        value = next(iter(value.node().inputs()))
    if not names or value.node().kind() != "prim::Param":
        return None
    found = module
    for name in names:
        found = getattr(found, name)
    first = found[0] if isinstance(found, list) else found
    return int(first.shape[axis]) if first.dim() == 2 else None
