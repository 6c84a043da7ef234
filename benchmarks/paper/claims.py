"""Each sentence of the paper's results section: what its own tables say about it, and what our records say.

A claim about the ablation names two rows of Table II and a figure; the finding is the reduction from one to the other
on each body, with its interval. What has no record is called not measured.
"""

from dataclasses import dataclass

from benchmarks.paper import judgements as of_networks
from benchmarks.paper import judgements_figures as of_pictures
from benchmarks.paper.intervals import Interval
from benchmarks.paper.judgements import Judge
from benchmarks.paper.plan import Training
from benchmarks.paper.published import FIGURE_NAMES, LOWERED, TABLE_1, TABLE_2, reduction
from benchmarks.paper.records import Records
from haustra.core.text import counted


@dataclass(frozen=True)
class Reduction:
    """By how much of row `beside` the figure of `row` is lower on a scene."""

    scene: str
    row: str
    beside: str
    figure: str


@dataclass(frozen=True)
class Claim:
    """A sentence, shortened; `own`: what the paper's own tables give; then what we measure of it: reductions of Table
    II, or a judgement of its own."""

    text: str
    own: str = ""
    compared: tuple[Reduction, ...] = ()
    judge: Judge | None = None


SCENE_NAMES = of_networks.PRINTED_SCENES


def published(*of: Reduction) -> str:
    """The same reductions by the paper's Table II."""
    cells = (f"{FIGURE_NAMES[r.figure]} {100 * reduction(r.scene, r.row, r.beside, r.figure):.1f} %" for r in of)
    return f"Table II: {', '.join(cells)}"


def below_std50(scene: str) -> str:
    """Reductions of MSCSA-Net below StD-ResNet50 by the paper's Table I."""
    ours, rival = TABLE_1[scene]["MSCSA-Net"], TABLE_1[scene]["StD-ResNet50"]
    return "Table I: " + ", ".join(f"{FIGURE_NAMES[f]} {100 * (1 - ours[f] / rival[f]):.1f} %" for f in LOWERED)


def lead_in_delta(scene: str) -> float:
    """delta 1 of MSCSA-Net less that of the best other network, by the paper's Table I."""
    others = (row["delta_1"] for name, row in TABLE_1[scene].items() if name != "MSCSA-Net")
    return TABLE_1[scene]["MSCSA-Net"]["delta_1"] - max(others)


def _leads() -> str:
    leads = {SCENE_NAMES[scene]: lead_in_delta(scene) for scene in TABLE_1}
    mean = sum(leads.values()) / len(leads)
    return "Table I: " + ", ".join(f"{name} {lead:.4f}" for name, lead in leads.items()) + f"; mean {mean:.4f}"


def _delta_1(row: str) -> str:
    return f"{TABLE_2['small_intestine'][row]['delta_1']:.4f}"


def _scenes(figure: str) -> str:
    values = (f"{SCENE_NAMES[scene]} {rows['MSCSA-Net'][figure]:.2f}" for scene, rows in TABLE_1.items())
    return f"{FIGURE_NAMES[figure]} of MSCSA-Net {', '.join(values)}"


def claims() -> list[Claim]:
    """In the order of the paper's sections III-C and III-D."""
    full = {scene: Reduction(scene, "full", "baseline", "abs_rel") for scene in TABLE_2}
    msc = {scene: Reduction(scene, "+MSC", "baseline", "rmse") for scene in TABLE_2}
    sa = {scene: Reduction(scene, "+SA", "baseline", "abs_rel") for scene in TABLE_2}
    last = {scene: Reduction(scene, "full", "+MSC", "abs_rel") for scene in TABLE_2}
    mae = Reduction("small_intestine", "+MSC", "baseline", "mae")
    of_colon = Reduction("colon", "+MSC", "baseline", "mae")
    gaenet, mscsa = TABLE_1["ccd"]["GAENet"], TABLE_1["ccd"]["MSCSA-Net"]
    return [
        Claim(
            "Figure 4: StD-ResNet18, GAENet and NLSPN produce abnormal results in the small intestine.",
            judge=of_pictures.abnormal_in_small_intestine,
        ),
        Claim("Figure 4: the depth maps from StD have more blurred edges than ours.", judge=of_pictures.blurred_by_std),
        Claim(
            "GAENet is second only to ours in the colon and has large errors elsewhere.",
            _scenes_of("GAENet"),
            judge=of_networks.best_rival_in_colon,
        ),
        Claim("Figure 4: NLSPN only predicts the rough direction of depth.", judge=of_pictures.rough_by_nlspn),
        Claim(
            "Figure 4: our depth maps are closer to the truth, with clear edges, on all data sets.",
            judge=of_pictures.closest_everywhere,
        ),
        Claim("Figure 4: in CSD the depth of all methods is shifted in scale.", judge=of_pictures.shifted_scale_in_csd),
        Claim(
            "All methods do better in the colon than on the other data.",
            f"{_scenes('rmse')}; {_scenes('abs_rel')}",
            judge=of_networks.colon_is_easiest,
        ),
        Claim(
            "On CCD the accuracy of GAENet is 0.5762, ours 0.9803.",
            f"Table I: {gaenet['delta_1']:.4f}, {mscsa['delta_1']:.4f}",
            judge=of_networks.delta_1_on("ccd", ("gaenet", of_networks.PRINTED)),
        ),
        Claim(
            "The errors on CSD are large since its depths are; its accuracy is 0.9736.",
            f"Table I: {TABLE_1['csd']['MSCSA-Net']['delta_1']:.4f}",
            judge=of_networks.delta_1_on("csd", (of_networks.PRINTED,)),
        ),
        Claim(
            "Colon: RMSE, abs.REL, MAE 40.8, 45.8, 49.6 % below StD-ResNet50.",
            below_std50("colon"),
            judge=of_networks.reductions_below("colon", "std50"),
        ),
        Claim(
            "Small intestine: 56.6, 69.9, 70.2 % below StD-ResNet50.",
            below_std50("small_intestine"),
            judge=of_networks.reductions_below("small_intestine", "std50"),
        ),
        Claim(
            "In the small intestine the reduction is more significant.",
            f"{below_std50('small_intestine')} against {below_std50('colon').removeprefix('Table I: ')}",
            judge=of_networks.larger_in_small_intestine("std50"),
        ),
        Claim(
            "delta 1 is better by at least 0.03 than with the other methods.",
            _leads(),
            judge=of_networks.leads_in_delta_1(0.03, mean=False),
        ),
        Claim(
            "Beside the best other method, delta 1 is better by 0.01 in the mean.",
            _leads(),
            judge=of_networks.leads_in_delta_1(0.01, mean=True),
        ),
        Claim(
            "Figure 5: accuracy rises with the number of points, more steeply for uniform ones.",
            judge=of_pictures.steeper_for_uniform,
        ),
        Claim(
            "Figure 5: from 10 to 1,000 points feature points gain little over uniform ones.",
            judge=of_pictures.gain_of_features((10, 100, 1000)),
        ),
        Claim(
            "The same sentence read of the number of points: from 10 to 1,000 accuracy improves less with features.",
            judge=of_pictures.growth_with_features,
        ),
        Claim(
            "Figure 5: at 10,000 points feature points still gain, but are the worse ones.",
            judge=of_pictures.many_features,
        ),
        Claim(
            "Full is far better than the baseline: abs.REL falls by up to 49.7 % in the colon,", *_both(full["colon"])
        ),
        Claim("and by up to 70.8 % in the small intestine.", *_both(full["small_intestine"])),
        Claim("MSC alone takes 30.1 % off the RMSE in the colon,", *_both(msc["colon"])),
        Claim("and 54.4 % in the small intestine.", *_both(msc["small_intestine"])),
        Claim(
            "In the small intestine MSC takes 38.7 % off the MAE.",
            f"{published(mae)}; the 38.7 % are the colon's ({published(of_colon)})",
            (mae, of_colon),
        ),
        Claim("SA alone takes 11.0 % off the abs.REL in the colon.", *_both(sa["colon"])),
        Claim(
            "In the small intestine SA alone is worse than the baseline.",
            f"{published(sa['small_intestine'])}; delta 1 {_delta_1('+SA')} against {_delta_1('baseline')}: better",
            (sa["small_intestine"],),
        ),
        Claim("Beside MSC alone, full takes 26.9 % off the abs.REL in the colon,", *_both(last["colon"])),
        Claim("and 13.2 % in the small intestine.", *_both(last["small_intestine"])),
        Claim(
            "Figure 6: features are richer behind SA, most of all in the small intestine.",
            judge=of_pictures.richer_by_sa,
        ),
        Claim("Figure 6: SA adds features at edges, and in near and far regions.", judge=of_pictures.where_sa_adds),
    ]


def _both(of: Reduction) -> tuple[str, tuple[Reduction, ...]]:
    return published(of), (of,)


def _scenes_of(method: str) -> str:
    values = (f"{SCENE_NAMES[scene]} {rows[method]['abs_rel']:.2f} %" for scene, rows in TABLE_1.items())
    return f"Table I, abs.REL of {method}: {', '.join(values)}"


def finding(records: Records, of: Reduction, training: Training) -> tuple[Interval, int] | None:
    """The measured reduction, and the number of seeds."""
    runs = training.runs(of.scene)
    return records.reduction(of.scene, runs[of.row], runs[of.beside], of.figure)


def verdict(found: tuple[Interval, int] | None, claimed: float) -> str:
    """What the interval says of a reduction that the paper claims; a negative one is an increase. Of one seed, whose
    interval knows nothing of other seeds, its sign alone."""
    if found is None:
        return "not measured"
    interval, seeds = found
    return f"{interval.word(claimed) if seeds > 1 else interval.sign(claimed)}, {counted(seeds, 'seed')}"
