"""Presets of learning: sizes of networks and lengths of training, by preset, task and model."""

from __future__ import annotations

#: What a preset sets; keys that the configuration gives win.
PRESETS: dict[str, dict[str, dict]] = {
    "tiny": {
        "training": {"steps": 60, "minutes": 2.0, "batch_size": 8, "validate_every": 20},
        "network": {"points": 512, "depth": 4, "width": 64, "layers": 2},
    },
    "cpu": {
        # Octrees of depth 4 take a third of the time that those of depth 5 take.
        "training": {"steps": 2000, "minutes": 20.0, "batch_size": 16, "validate_every": 250},
        "network": {"points": 2048, "depth": 4, "width": 256, "layers": 3},
    },
    "small": {
        "training": {"steps": 20_000, "minutes": 10.0, "batch_size": 128, "workers": 4},
        "network": {"points": 4096, "depth": 5, "width": 256, "layers": 3},
    },
    "paper": {
        "training": {"steps": 100_000, "minutes": 100_000.0, "batch_size": 16, "workers": 4},
        "network": {"points": 4096, "depth": 6, "width": 256, "layers": 3},
    },
}

#: What a preset sets otherwise for a task, or for one of its models.
OWN_PRESETS: dict[str, dict[str, dict]] = {
    # A small network that sees spectra alone: many cheap steps.
    "frequencies/ritz": {
        preset: {
            "training": {
                "batch_size": 32, "learning_rate": 4e-3, "weight_decay": 0.1, "schedule": "cosine",
                "warmup_steps": 300, **own,
            },
            "network": {"width": 64, "layers": 5},
        }
        for preset, own in {
            "cpu": {"steps": 6000}, "small": {"batch_size": 128}, "paper": {"steps": 20_000},
        }.items()
    },
    # A step assembles and solves a problem of 147 unknowns for each body.
    "frequencies/subspace": {"cpu": {"training": {"steps": 250, "batch_size": 2, "validate_every": 125}}},
    "reconstruction": {
        "tiny": {
            "training": {"batch_size": 4, "learning_rate": 1e-3, "schedule": "cosine", "warmup_steps": 5},
            "network": {"width": 128, "voxel_points": 512, "distances": 512, "cells": 24},
        },
        "cpu": {
            "training": {
                "steps": 6000, "minutes": 60.0, "learning_rate": 5e-4, "schedule": "cosine", "warmup_steps": 200,
            },
            "network": {"width": 128},
        },
        "small": {
            "training": {"batch_size": 32, "learning_rate": 2e-4, "schedule": "cosine", "warmup_steps": 500},
            "network": {
                "width": 384, "latents": 256, "encoder_blocks": 4, "decoder_blocks": 6,
                "voxel_points": 8192, "distances": 4096, "cells": 64,
            },
        },
        "paper": {
            "training": {
                "batch_size": 48, "learning_rate": 1e-5, "betas": (0.9, 0.99), "schedule": "constant",
                "clip_norm": None, "precision": "float32",
            },
            "network": {
                "width": 768, "latents": 1024, "encoder_blocks": 8, "decoder_blocks": 12,
                "voxel_points": 32_768, "distances": 16_384, "cells": 128,
            },
        },
    },
    "retrieval": {
        "cpu": {"training": {"steps": 1500, "batch_size": 48, "validate_every": 100}},
        "small": {"training": {"steps": 10_000, "batch_size": 192}},
        "paper": {"training": {"batch_size": 192}},
    },
    # The published batch, and as many samples in all.
    "retrieval/published": {
        "cpu": {"training": {"steps": 3000, "batch_size": 24}},
        "small": {"training": {"steps": 80_000, "batch_size": 24}},
        "paper": {"training": {"batch_size": 24}},
    },
}  # fmt: skip
