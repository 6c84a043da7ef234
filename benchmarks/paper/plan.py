"""What is trained and judged for each of the paper's tables, in the order in which a queue should do it."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

SEEDS = 3
STEPS = 1000  # of 10 frames: the budget of every row
SIZE = 160  # px
PAPER_SIZE = 320  # px
POINTS = 100  # uniform, in training and judging
TRAINING_FRAMES, JUDGED_FRAMES = 1500, 240  # judged: of 12 meshes never trained on, 20 frames of each
# Seeds of the frames to train on and of those to judge on, for the stand-in of each of the paper's scenes.
SCENES = {"colon": (51, 151), "small_intestine": (52, 152), "ccd": (53, 153), "csd": (54, 154)}

ROWS = ("baseline", "+SA", "+MSC", "full")
BODIES = {
    "early fusion": ("early-fusion", "early-fusion+sa", "early-fusion+msc", "mscsa-early-fusion"),
    "U-Net, plain": ("unet-plain", "unet-plain+sa", "unet-plain+msc", "mscsa-plain"),
    "U-Net, batch normalisation": ("unet", "unet+sa", "unet+msc", "mscsa"),
}
RESIDUAL = {"plain": "mscsa-plain+residual", "batch normalisation": "mscsa+residual"}
# The full network on the U-Net, changed in one thing, and what that tells about batch normalisation.
NORMALISATIONS = {
    "none": "mscsa-plain",
    "batch": "mscsa",
    "batch, LeakyReLU and He start": "mscsa-batch-leaky",
    "batch, frozen from step 200": "mscsa-frozen",
    "each frame by itself": "mscsa-frame",
    "batch, residual": "mscsa+residual",
}
METRES, CONSTANT, AS_SOURCE = "depth in metres", "constant rate", "depth in metres, constant rate"
# Choices of training that the paper leaves open, changed one at a time on the full early-fusion network.
CHANGES: dict[str, dict[str, Any]] = {
    "no clipping of gradients": {"clip": 0.0},
    "float32": {"bf16": False},
    CONSTANT: {"decay_at": 1.0},
    "a tenth of the rate after each third": {"schedule": "thirds"},
    "every frame once before one comes again": {"passes": True},
    METRES: {"unit_mm": 1000.0},
    "each pixel by chance, 100 in the mean": {"sampler": "by_chance"},
    # The source trains MSC by itself on KITTI; the rest then has as many steps as it has in the other rows.
    "MSC trained first and held fixed": {"msc_first": 300, "steps": 1300, "decay_at": 1000 / 1300},
}
# What the released training of the paper's source has, both at once; for Table II's rows only.
BOTH: dict[str, dict[str, Any]] = {AS_SOURCE: CHANGES[METRES] | CHANGES[CONSTANT]}
# The same weights judged thrice: as they were trained, in half precision as all other rows are, and on other frames.
FLOAT32, AS_SAVED, TRAINED_ON = JUDGED_THRICE = (
    "judged in float32",
    "the same weights in half precision",
    "the same on frames that were trained on",
)
# How batches of four scenes were drawn at first: networks with batch normalisation are judged wrongly by it, since they
# learn by the statistics of one scene at a time and are judged by a mixture of the last ones.
ONE_SCENE = "batches of one scene"
AT_FIRST: dict[str, dict[str, Any]] = {ONE_SCENE: {"mix_shards": False}}
# Readings of what the paper leaves open of the network itself.
READINGS = {
    "confidence at the last convolution too": "mscsa-early-fusion+confidence-last",
    "all scales of the pyramid handed on": "mscsa-early-fusion+all-scales",
    "sparse depth at the input only": "mscsa-early-fusion+sparse-first",
    "Gamma as printed, beta 1": "mscsa-early-fusion+gamma-1",
    "epsilon 1e-6 in the numerator of Eq. 2": "mscsa-early-fusion+epsilon",
    "epsilon 1e-6 in the denominator of Eq. 1": "mscsa-early-fusion+guard",
    "weights replaced by Gamma in each step": "mscsa-early-fusion+replaces",
    "like channels weigh most in SA": "mscsa-early-fusion+similar",
    "a learnt weight of SA, from zero": "mscsa-early-fusion+learned-gain",
    "four levels instead of five (0.34 M parameters)": "mscsa-early-fusion+four-levels",
    "half the channels (0.12 M parameters)": "mscsa-early-fusion+half-width",
    "twice the channels (1.93 M parameters)": "mscsa-early-fusion+double-width",
}
UNTRAINED = {"linear": "linear", "nearest": "nearest", "shipped": "mscsa"}  # label: name for `load_predictor`
RIVALS = ("std18", "std50", "gaenet", "nlspn")
OTHER_PARAMETERS = ("std18", "std50", "nlspn")  # rivals that at equal computation have another number of parameters
OURS = ("mscsa-plain", "mscsa-early-fusion", "mscsa+residual", "mscsa-plain+residual")
# Table I: until the held-out error stops falling (`completion.training.plateau`), at most so many steps.
CONVERGED: dict[str, Any] = {"schedule": "plateau"}
MOST_STEPS = 8000
# The paper's ten epochs of 15,660 frames in batches of 10, which end at the full rate or, as here, at a tenth of it.
PAPER_STEPS = 15_660
PAPER_LENGTH = (*BODIES["early fusion"], "mscsa-plain", "unet-plain", "mscsa", "unet")
POINT_COUNTS = (10, 100, 1000, 10_000)  # of Figure 5
SAMPLERS = ("uniform", "features")
FIGURE_5 = "mscsa-early-fusion"
DECAY_AT = 0.7  # of the run: a tenth of the rate from there on, since a run that ends at the full rate is judged at
# a random moment


@dataclass(frozen=True)
class Run:
    """One training and its judgement, or only the judgement of a method of `UNTRAINED`."""

    scenes: tuple[str, ...]  # one network for all of them
    model: str  # of completion.networks.registry, or of `UNTRAINED`
    seed: int = 0
    steps: int = STEPS
    change: str = ""  # of `CHANGES`, `BOTH` or `AT_FIRST`, or `JUDGED_THRICE`
    size: str = "small"  # of completion.networks.registry
    points: int = POINTS
    sampler: str = "uniform"
    converged: bool = False  # `steps` are the most that it takes
    side: int = SIZE  # px of its frames

    @property
    def name(self) -> str:
        """Stem of its record."""
        extra = [self.size] if self.size != "small" else []
        extra += [f"{self.points}-{self.sampler}"] if (self.points, self.sampler) != (POINTS, "uniform") else []
        extra += ["converged"] if self.converged else []
        extra += [f"{self.side}px"] if self.side != SIZE else []
        parts = ["_".join(self.scenes), self.model, *self.change.split(), *extra, str(self.steps), str(self.seed)]
        return "-".join(parts).replace("+", "-")

    @property
    def weights(self) -> str:
        """Stem of its weights, which runs that differ in how they are judged share."""
        return (replace(self, change="") if self.change in JUDGED_THRICE else self).name

    @property
    def settings(self) -> dict[str, Any]:
        """Of training, beside the paper's preset."""
        ending = CONVERGED if self.converged else {"decay_at": DECAY_AT}
        about = {"size": self.size, "points": self.points, "sampler": self.sampler, "seed": self.seed}
        return about | ending | {"steps": self.steps} | (CHANGES | BOTH | AT_FIRST).get(self.change, {})


@dataclass(frozen=True)
class Training:
    """How the four rows of Table II on one body were trained."""

    body: str  # of `BODIES`
    steps: int = STEPS
    change: str = ""

    @property
    def label(self) -> str:
        """For a column, or before a row's name."""
        given = [self.body, f"{self.steps:,} steps" if self.steps != STEPS else "", self.change]
        return ", ".join(filter(None, given))

    def runs(self, scene: str) -> dict[str, Run]:
        """By row."""
        return {
            row: Run((scene,), model, steps=self.steps, change=self.change)
            for row, model in zip(ROWS, BODIES[self.body], strict=True)
        }


EARLY = next(iter(BODIES))
IN_METRES = Training(EARLY, change=METRES)
AT_LENGTH = [Training(body, PAPER_STEPS) for body in BODIES]
AS_ITS_SOURCE = Training(EARLY, PAPER_STEPS, AS_SOURCE)
# By scene, of which rows are trained; the paper's sentences are judged by each of them.
TRAININGS = {
    "colon": [
        *map(Training, BODIES),
        IN_METRES,
        *AT_LENGTH,
        *(Training(EARLY, PAPER_STEPS, change) for change in (CONSTANT, METRES, AS_SOURCE)),
    ],
    "small_intestine": [*map(Training, BODIES)],
}


@dataclass(frozen=True)
class Table:
    """Runs of one table, most wanted first."""

    title: str
    runs: list[Run] = field(default_factory=list)


# What decides most comes first: the printed form with and without batch normalisation, each beside its baseline.
FIRST = ("mscsa-plain", "mscsa", "mscsa-early-fusion", "mscsa-frozen", "unet-plain", "early-fusion", "unet")


def ablation(scene: str, seeds: range) -> Iterator[Run]:
    """Table II on one scene: all rows of a seed before the next seed."""
    for seed, body, row in product(seeds, BODIES, range(len(ROWS))):
        yield Run((scene,), BODIES[body][row], seed)


def one_seed(seed: int) -> Iterator[Run]:
    """Everything on the colon that has this seed; a run may come twice."""
    models = (*FIRST, *NORMALISATIONS.values(), RESIDUAL["plain"])
    yield from (Run(("colon",), model, seed) for model in models if seed < 2 or model in FIRST)
    yield from ablation("colon", range(seed, seed + 1))


def tables() -> dict[str, Table]:
    """All tables by the name that the command line takes."""
    floors = [Run((scene,), label) for scene in ("colon", "small_intestine") for label in UNTRAINED]
    colon = [run for seed in range(SEEDS) for run in one_seed(seed)]
    intestine = list(ablation("small_intestine", range(SEEDS)))
    changes = [
        Run(("colon",), "mscsa-early-fusion", seed, change=change)
        for seed in range(2)
        for change in (*CHANGES, *JUDGED_THRICE)
    ]
    changes += [Run(("colon",), model, seed) for seed in range(2) for model in READINGS.values()]
    changes += [Run(("colon",), FIGURE_5, seed, side=PAPER_SIZE) for seed in range(2)]
    in_metres = product(range(SEEDS), BODIES[EARLY])  # Table II's rows as they are in the sources' unit
    changes += [Run(("colon",), model, seed, change=METRES) for seed, model in in_metres]
    return {
        "2": Table("Table II, the ablation", [*unique(colon), *intestine]),
        "untrained": Table("interpolation, and the model that `reconstruct` ships", floors),
        "protocol": Table("choices of training that the paper leaves open", unique(changes)),
        "1": Table("Table I, all networks on four scenes", list(table_1())),
        "1 at equal steps": Table("Table I with one number of steps", list(equal_steps())),
        "figure 5": Table("numbers of uniform and of feature points, each trained on", unique([*figure_5()])),
        "length": Table("the paper's number of steps", unique([*at_length()])),
    }


def table_1() -> Iterator[Run]:
    """One network for four scenes, until it has converged: at equal computation, and rivals at equal parameters."""
    four = tuple(SCENES)
    yield from (Run(four, label) for label in UNTRAINED)
    for seed in range(2):
        yield from (Run(four, model, seed, MOST_STEPS, converged=True) for model in (*OURS, *RIVALS))
        for model in OTHER_PARAMETERS:
            yield Run(four, model, seed, MOST_STEPS, size="same-parameters", converged=True)


def equal_steps() -> Iterator[Run]:
    """Whether Table I depends on its rule for ending: as many steps for every network."""
    for model in ("std50", "mscsa-plain", *(model for model in RIVALS if model != "std50")):
        yield Run(tuple(SCENES), model, 0, MOST_STEPS)


def figure_5() -> Iterator[Run]:
    """The full early-fusion network on the colon, trained and judged with each number of points of each sampler."""
    for seed, points, sampler in product(range(2), POINT_COUNTS, SAMPLERS):
        yield Run(("colon",), FIGURE_5, seed, points=points, sampler=sampler)


def at_length() -> Iterator[Run]:
    """The paper's number of steps on the colon: each body, then the early-fusion rows as their source trains them, in
    metres, and with more seeds."""
    yield from (Run(("colon",), model, 0, PAPER_STEPS) for model in PAPER_LENGTH)
    for change, seeds in ((AS_SOURCE, SEEDS), ("", SEEDS), (METRES, 2), (CONSTANT, 1)):
        for seed, model in product(range(seeds), BODIES[EARLY]):
            yield Run(("colon",), model, seed, PAPER_STEPS, change)


def unique(runs: list[Run]) -> list[Run]:
    """Each run once, where it comes first."""
    return list(dict.fromkeys(runs))
