"""What the paper prints in Tables I and II: RMSE in cm, abs.REL in percent, MAE in cm, delta 1, delta 2."""

from benchmarks.paper.plan import ROWS

FIGURES = ("rmse", "abs_rel", "mae", "delta_1", "delta_2")
FIGURE_NAMES = {"rmse": "RMSE", "abs_rel": "abs.REL", "mae": "MAE", "delta_1": "delta 1"}
LOWERED = ("rmse", "abs_rel", "mae")  # figures whose reductions the paper gives
Row = dict[str, float]


def _rows(names: tuple[str, ...], *values: tuple[float, ...]) -> dict[str, Row]:
    return {name: dict(zip(FIGURES, row, strict=True)) for name, row in zip(names, values, strict=True)}


METHODS = ("StD-ResNet18", "StD-ResNet50", "GAENet", "NLSPN", "MSCSA-Net")
TABLE_1 = {
    "colon": _rows(
        METHODS,
        (1.0244, 5.7732, 0.7627, 0.9770, 0.9926),
        (1.0403, 5.7023, 0.7878, 0.9789, 0.9942),
        (0.9605, 4.8107, 0.7091, 0.9883, 0.9980),
        (1.1395, 5.5340, 0.6582, 0.9603, 0.9897),
        (0.6158, 3.0916, 0.4097, 0.9904, 0.9982),
    ),
    "small_intestine": _rows(
        METHODS,
        (1.9058, 5.2290, 1.2930, 0.9845, 0.9987),
        (1.8712, 5.7232, 1.4253, 0.9887, 0.9992),
        (2.0940, 5.8193, 1.4615, 0.9830, 0.9981),
        (1.2679, 3.2163, 0.7796, 0.9904, 0.9975),
        (0.8121, 1.7241, 0.4244, 0.9954, 0.9995),
    ),
    "ccd": _rows(
        METHODS,
        (1.9789, 7.9302, 1.0927, 0.9530, 0.9928),
        (2.0251, 7.9456, 1.1552, 0.9417, 0.9922),
        (5.9393, 38.0345, 3.9816, 0.5762, 0.8082),
        (2.7441, 9.7676, 1.4269, 0.9111, 0.9758),
        (1.3501, 5.1058, 0.7650, 0.9803, 0.9971),
    ),
    "csd": _rows(
        METHODS,
        (32.7593, 6.7433, 18.0611, 0.9641, 0.9956),
        (38.4818, 7.1197, 18.8038, 0.9504, 0.9926),
        (41.7737, 11.0334, 25.8246, 0.8828, 0.9845),
        (42.4963, 7.2895, 19.4174, 0.9355, 0.9834),
        (30.3093, 4.9252, 13.5245, 0.9736, 0.9961),
    ),
}
TABLE_2 = {
    "colon": _rows(
        ROWS,
        (1.0160, 6.1511, 0.7977, 0.9703, 0.9966),
        (0.9914, 5.4719, 0.7666, 0.9846, 0.9974),
        (0.7099, 4.2276, 0.4892, 0.9762, 0.9945),
        (0.6158, 3.0916, 0.4097, 0.9904, 0.9982),
    ),
    "small_intestine": _rows(
        ROWS,
        (1.9113, 5.9114, 1.4357, 0.9844, 0.9994),
        (2.0225, 6.2830, 1.5497, 0.9869, 0.9994),
        (0.8716, 1.9867, 0.4851, 0.9954, 0.9995),
        (0.8121, 1.7241, 0.4244, 0.9954, 0.9995),
    ),
}


def reduction(scene: str, row: str, beside: str, figure: str) -> float:
    """By how much of `beside` a row of Table II is lower, as a fraction."""
    return 1 - TABLE_2[scene][row][figure] / TABLE_2[scene][beside][figure]
