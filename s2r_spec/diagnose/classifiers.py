"""Trained classifiers as plain arrays: what a cache file may hold, and what predicts without scikit-learn.

Data: a description x (n, d). Unknown: the probability of each of K labels. Models, as scikit-learn trains them:

    Network   h_0 = x,  h_{l+1} = max(0, h_l W_l + b_l),  P = 1 / (1 + exp(−(h_L W_L + b_L)))   (MLPClassifier)
    Forest    P = mean over trees of the share of label 1 in the leaf that x falls in           (ExtraTreesClassifier)

Both give the probabilities of the estimator they were taken from, and are nothing but numbers: reading one from a
file runs nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LEAF = -1
"""Definition: the child of a node that has none."""


@dataclass(frozen=True)
class Network:
    """A multilayer perceptron with ReLU layers and independent logistic outputs.

    Attributes:
        weights: of each layer (inputs, outputs).
        biases: of each layer (outputs,).
    """

    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]

    def __post_init__(self) -> None:
        inputs = self.weights[0].shape[0] if self.weights else 0
        for weight, bias in zip(self.weights, self.biases, strict=True):
            if weight.shape != (inputs, *bias.shape) or bias.ndim != 1:
                raise ValueError("the layers of a network do not fit together")
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise ValueError("a network has weights that are not numbers")
            inputs = bias.shape[0]
        if not self.weights:
            raise ValueError("a network has no layers")

    @classmethod
    def of(cls, estimator: Any) -> Network:
        """Return what a fitted ``MLPClassifier`` with ReLU layers has learnt."""
        return cls(tuple(estimator.coefs_), tuple(estimator.intercepts_))

    def probabilities(self, x: FloatArray) -> FloatArray:
        """Return (n, K) probabilities of descriptions (n, d)."""
        from scipy.special import expit

        last = len(self.weights) - 1
        values = x
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = values @ weight + bias
            if layer < last:
                values = np.maximum(values, 0.0)
        return np.asarray(expit(values))


@dataclass(frozen=True)
class Forest:
    """Decision trees that vote on one label, all nodes of all trees in one table.

    Attributes:
        roots: (trees,) rows of the table at which the trees begin.
        left: (nodes,) row of the child to go to where x ≤ threshold; LEAF for none.
        right: (nodes,) row of the other child.
        column: (nodes,) of x.
        threshold: (nodes,).
        share: (nodes,) of label 1 among what was there in training.
    """

    roots: IntArray
    left: IntArray
    right: IntArray
    column: IntArray
    threshold: FloatArray
    share: FloatArray

    def __post_init__(self) -> None:
        nodes, rows = self.share.shape, np.arange(self.share.size)
        if not self.roots.size or any(
            each.shape != nodes for each in (self.left, self.right, self.column, self.threshold)
        ):
            raise ValueError("the tables of a forest do not fit together")
        if self.roots.min() < 0 or self.roots.max() >= rows.size or self.column.min() < 0:
            raise ValueError("a forest refers to rows that it lacks")
        inner = self.left != LEAF
        for child in (self.left, self.right):
            # A child lies behind its parent, so that every way ends in a leaf.
            if not ((child[inner] > rows[inner]) & (child[inner] < rows.size)).all():
                raise ValueError("a forest refers to rows that it lacks")
        if not ((self.share >= 0.0) & (self.share <= 1.0)).all():
            raise ValueError("a forest has shares outside 0 to 1")

    @classmethod
    def of(cls, estimator: Any) -> Forest:
        """Return what a fitted ``ExtraTreesClassifier`` of labels 0 and 1 has learnt."""
        trees = [one.tree_ for one in estimator.estimators_]
        sizes = [tree.node_count for tree in trees]
        roots = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)

        def children(of: Sequence[IntArray]) -> IntArray:
            rows = [np.where(each == LEAF, LEAF, each + root) for each, root in zip(of, roots, strict=True)]
            return np.concatenate(rows).astype(np.int64)

        inner = np.concatenate([tree.children_left != LEAF for tree in trees])
        column = np.concatenate([tree.feature for tree in trees]).astype(np.int64)
        return cls(
            roots,
            children([tree.children_left for tree in trees]),
            children([tree.children_right for tree in trees]),
            np.where(inner, column, 0),
            np.concatenate([tree.threshold for tree in trees]),
            np.concatenate([tree.value[:, 0, 1] for tree in trees]),
        )

    def probabilities(self, x: FloatArray) -> FloatArray:
        """Return (n,) probabilities of label 1 of descriptions (n, d)."""
        rounded = x.astype(np.float32)  # as scikit-learn reads them
        total = np.zeros(len(x))
        for root in self.roots:
            at = np.full(len(x), root)
            while (inner := self.left[at] != LEAF).any():
                value = rounded[np.arange(len(x)), self.column[at]]
                down = np.where(value <= self.threshold[at], self.left[at], self.right[at])
                at = np.where(inner, down, at)
            total += self.share[at]
        return np.asarray(total / len(self.roots))
