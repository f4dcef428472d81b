"""Asking a trained model of the task ``frequencies`` about a body that was never simulated."""

from __future__ import annotations

import pickle
from collections.abc import Mapping

import numpy as np
import torch

from vibraverse import __version__
from vibraverse.config.learn import Features
from vibraverse.contract import products
from vibraverse.contract.errors import UsageError
from vibraverse.contract.readable import unreadable
from vibraverse.learn.evaluation import answers
from vibraverse.learn.features import shape_arrays
from vibraverse.learn.metrics import LOWEST
from vibraverse.learn.samples import Unsimulated
from vibraverse.learn.sides import SIDES, TEST
from vibraverse.learn.tasks import task_of
from vibraverse.learn.trained import MODEL, TrainedModel

#: Any closed surface: a network's layers have the same sizes for all of them.
_TETRAHEDRON = (
    np.array([[0.9, 0.9, 0.9], [0.9, -0.9, -0.9], [-0.9, 0.9, -0.9], [-0.9, -0.9, 0.9]]),
    np.array([[0, 2, 3], [0, 1, 2], [0, 3, 1], [1, 3, 2]]),
)


class Predictor:
    """A trained network, loaded. Raises :class:`UsageError` for weights that are missing, damaged or of other code."""

    def __init__(self, trained: TrainedModel, threads: int = 1):
        torch.set_num_threads(threads)
        self.trained = trained
        training = trained.options.training.model_copy(
            update={"workers": 0}
        )  # one body needs no process of its own
        self._options = trained.options.model_copy(update={"training": training})
        layout = trained.layout
        self._features = Features(
            points=layout.points,
            poisson_nodes=layout.poisson_nodes,
            poisson_range=layout.poisson_range,
            ritz_degrees=layout.ritz_degrees,
            ritz_unknowns=layout.ritz_unknowns,
        )
        task = self._task(*_TETRAHEDRON, "", "solid", 1.0, layout.materials)
        self._exact = task.exact
        self._model = self._loaded(task)

    def _loaded(self, task) -> torch.nn.Module:
        path = self.trained.folder / MODEL
        if wrong := unreadable(path, missing="copy the whole folder of the training"):
            raise UsageError(f"the weights of the model, {path}, {wrong}")
        if products.sha256(path) != self.trained.sha256:
            raise UsageError(
                f"{path} is not the file that its training wrote: it is damaged, or belongs to another one; copy the "
                "whole folder again, or train anew with `snakemake learn`"
            )
        model = task.model()
        try:
            model.load_state_dict(torch.load(path, map_location="cpu", weights_only=True)["best"])
        except (RuntimeError, LookupError, pickle.UnpicklingError):
            wrote = self.trained.record["provenance"]["vibraverse"]
            raise UsageError(
                f"{path} does not fit the network of vibraverse {__version__} ({wrote} wrote it); install that "
                "version, or train anew with `snakemake learn`"
            ) from None
        return model

    def frequencies(
        self,
        vertices: np.ndarray,
        faces: np.ndarray,
        object_: str,
        solidity: str,
        volume_m3: float,
        materials: Mapping[str, Mapping[str, float]],
    ) -> np.ndarray:
        """Return the frequencies (materials, m) in Hz of a body in a closed, normalised surface.

        Points on the surface are drawn by the object's id and the solidity, as those of the features are.
        """
        task = self._task(vertices, faces, object_, solidity, volume_m3, materials)
        found = answers(task, self._model, TEST, self._options.training)["found_hz"]
        return np.maximum(found[0], LOWEST)

    def _task(self, vertices, faces, object_, solidity, volume_m3, materials):
        """Return the task over one body."""
        wants_ritz = self.trained.options.model == "ritz"
        shape = shape_arrays(
            vertices, faces, object_, solidity, self.trained.layout.modes, self._features, wants_ritz
        )
        samples = Unsimulated(shape, volume_m3, self.trained.layout, materials)
        return task_of(samples, dict.fromkeys(SIDES, np.array([0])), self._options)

    def cautions(self, materials: Mapping[str, Mapping[str, float]]) -> list[str]:
        """Return a sentence for each way in which materials and body lie outside of what the model has learnt."""
        layout, found = self.trained.layout, []
        low, high = layout.poisson_range
        for name, one in materials.items():
            if not low <= one["poisson"] <= high:
                found.append(
                    f"Poisson's ratio of {name}, {one['poisson']:g}, lies outside {low:g} to {high:g}, which the model "
                    "was trained on"
                )
        if not self._exact:
            found.append(
                f"the model {self.trained.options.model!r} is not told the size of a body, and has seen the materials "
                f"{', '.join(layout.materials)} alone"
            )
        return found
