"""The stages of learning, a part of the table of all stages (``flow/steps.py``)."""

from __future__ import annotations

from vibraverse.contract.step import COMPARISON, LEARNING, PART, SHARD, TRAINING, Input, Output, Step

#: Folder of one training, below the results.
_TRAINED = "learn/{task}/{split}/{model}/seed-{seed}"

#: What every stage of a model or a baseline reads.
_SAMPLES = {
    "features": Input("features", "features of all shards (folders)", many=True, record="features.json"),
    "splits": Input("splits", "splits.tsv of the dataset"),
}

#: All stages of learning, in the order of the chain.
LEARNING_STEPS = (
    Step(
        name="features",
        version=5,  # 5: signed distances and coarse voxels
        help="write the arrays of one shard that training reads",
        per=SHARD,
        family="learn",
        inputs={"shard": Input("shard", "the shard (HDF5)")},
        outputs={
            "features": Output(
                "features",
                "learn/features/{shard}",
                "folder for memory-mapped arrays (NumPy) and features.json: bodies, materials, shapes",
                record="features.json",
            )
        },
        record="features",
        options="learn:Features",
        libraries=("numpy", "h5py", "numba", "pillow", "scipy"),
        passes_refusals=False,
    ),
    Step(
        name="train",
        version=4,  # 2 and 3: the record says how the features were made; 4: model `ritz` sees spectra alone
        help="train one model of a benchmark task",
        per=TRAINING,
        family="learn",
        inputs=_SAMPLES,
        outputs={
            "model": Output(
                "trained_model", f"{_TRAINED}/model.pt", "the best and the last weights (PyTorch)"
            ),
            "curves": Output("training_curves", f"{_TRAINED}/curves.csv", "loss and rates by step (CSV)"),
            "record": Output("training_record", f"{_TRAINED}/training.json", "how it was trained (JSON)"),
        },
        record="record",
        options="learn:RunOptions",
        libraries=("numpy", "scipy", "torch", "torchvision", "ocnn"),
        passes_refusals=False,
        gpus=True,
    ),
    Step(
        name="evaluate",
        version=2,  # 2: the record says what kind of model it is
        help="compare a trained model's answers with the truth",
        per=TRAINING,
        family="learn",
        inputs={
            "model": Input("trained_model", "the weights (PyTorch)"),
            "training": Input("training_record", "how it was trained (JSON)"),
            **_SAMPLES,
        },
        outputs={
            "answers": Output("answers", f"{_TRAINED}/answers.npz", "answers and truth of every tested body"),
            "record": Output("evaluation", f"{_TRAINED}/metrics.json", "measures by side and source (JSON)"),
        },
        record="record",
        options="learn:RunOptions",
        libraries=(
            "numpy",
            "scipy",
            "scikit-fem",
            "scikit-image",
            "numba",
            "torch",
            "torchvision",
            "ocnn",
        ),
        passes_refusals=False,
    ),
    Step(
        name="diffsound",
        version=1,
        help="seek the shapes of some bodies by descent through the physics",
        per=PART,
        family="learn",
        inputs=_SAMPLES,
        outputs={
            "found": Output(
                "descents",
                "learn/reconstruction/{split}/diffsound/{part}.npz",
                "measures of what was found for every body",
            ),
            "record": Output(
                "descents_record",
                "learn/reconstruction/{split}/diffsound/{part}.json",
                "bodies, seconds, how it was made (JSON)",
            ),
        },
        record="record",
        options="learn:DescentOptions",
        libraries=("numpy", "scipy", "scikit-fem", "scikit-image", "numba", "torch"),
        passes_refusals=False,
    ),
    Step(
        name="baselines",
        version=2,  # 2: the record says that they are baselines
        help="fit the simple predictors of a task, to compare with",
        per=COMPARISON,
        family="learn",
        inputs={
            **_SAMPLES,
            "descents": Input("descents", "what DiffSound found, in parts", many=True, optional=True),
        },
        outputs={
            "record": Output(
                "baselines", "learn/{task}/{split}/baselines.json", "measures of all baselines (JSON)"
            ),
        },
        record="record",
        options="learn:RunOptions",
        libraries=("numpy", "pillow", "scipy", "scikit-image", "scikit-learn", "numba"),
        passes_refusals=False,
    ),
    Step(
        name="results",
        version=2,  # 2: the kind of each method, and all values where trainings of a row differ
        help="join the measures of all models into one table",
        per=LEARNING,
        family="learn",
        inputs={
            "evaluations": Input("evaluation", "measures of all models (JSON)", many=True),
            "baselines": Input("baselines", "measures of all baselines (JSON)", many=True),
        },
        outputs={
            "table": Output(
                "results_table", "learn/results.tsv", "a row per model, split, side and measure (TSV)"
            ),
            "record": Output("results_record", "learn/results.json", "the same with means over seeds (JSON)"),
        },
        record="record",
        libraries=("numpy",),
        passes_refusals=False,
    ),
    Step(
        name="learn_page",
        version=2,  # 2: its tables are reached with the keyboard, and the colour of baselines is darker
        help="write the page of learning: tables, curves, sounds to compare",
        per=LEARNING,
        family="report",
        inputs={
            "results": Input("results_record", "the table of all models (JSON)"),
            "evaluations": Input("evaluation", "measures of all models (JSON)", many=True),
            "curves": Input("training_curves", "loss and rates of all models by step (CSV)", many=True),
            "answers": Input("answers", "answers and truth of all models", many=True),
            **_SAMPLES,
            "dataset": Input("dataset_record", "dataset.json, for the damping of the materials"),
            "report": Input("report", "the page of the dataset, to link, where it exists", optional=True),
        },
        outputs={
            "page": Output("learn_page", "learn/index.html", "index.html; its sounds go to assets/ beside it")
        },
        libraries=("jinja2", "matplotlib", "numpy", "scipy", "soundfile"),
        passes_refusals=False,
    ),
)
