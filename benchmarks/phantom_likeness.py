"""How like the phantom is to pictures that nobody here made: a sheet to look at, and statistics of both.

    python -m benchmarks.phantom_likeness ../shared/data --sheet likeness.png --json likeness.json

Every source is cut to its centre square and brought to 320 px. The phantom's looks were tuned by eye beside these
very pictures, so the distances say how far tuning has come, not how well it would carry over. Nothing is trained here.
Frames of one film or one colon resemble each other: a spread over 24 frames of four colons is not one of 24 patients.
"""

import argparse
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import spearmanr, wasserstein_distance

from benchmarks.record import spread, write
from haustra.phantom.config import PhantomConfig
from haustra.phantom.dataset.scenes import SCENES, scene_config
from haustra.phantom.dataset.script import write_script
from haustra.phantom.imaging.render import Phantom

SIZE = 320  # px
GAMMA = 2.2
SHOWN = 4  # frames of every source on the sheet
BINS = np.arange(0.0, 257.0, 0.5)  # grey levels per pixel
SIFT = cv2.SIFT_create(contrastThreshold=0.02)
COLUMNS = {
    "gradient": "gradient, grey levels/px, median of the picture",
    "keypoints": "SIFT keypoints at contrast 0.02",
    "rank": "Spearman of brightest channel and depth",
    "slope": "slope of log linear brightness over log depth; -2 is one distant lamp",
    "brightness": "mean grey level",
    "saturation": "mean HSV saturation, %",
    "hue": "mean hue, deg",
    "clipped": "pixels with a channel at 254 or more, %",
}


@dataclass(frozen=True)
class Picture:
    """RGB uint8 (S,S,3) and, where known, z-depth (S,S) in any unit, 0 = none."""

    image: np.ndarray
    depth: np.ndarray | None = None


def square(image: np.ndarray, interpolation: int = cv2.INTER_AREA) -> np.ndarray:
    """The centre square at SIZE px."""
    height, width = image.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    return cv2.resize(image[top : top + side, left : left + side], (SIZE, SIZE), interpolation=interpolation)


def read(path: Path, depth: Path | None = None) -> Picture:
    """A picture of 8 or 16 bits, and the depth map beside it."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    image = (image // 257).astype(np.uint8) if image.dtype == np.uint16 else image
    rgb = np.ascontiguousarray(square(image[..., :3])[..., ::-1])
    if depth is None:
        return Picture(rgb)
    return Picture(rgb, square(cv2.imread(str(depth), cv2.IMREAD_UNCHANGED).astype(np.float32), cv2.INTER_NEAREST))


def real_sources(data: Path) -> dict[str, list[Picture]]:
    """Whatever is there of the shared data, by name."""
    found = {
        "ctcolon": [read(path, data / "ctcolon/depth" / path.name) for path in sorted(data.glob("ctcolon/rgb/*.png"))],
        "simcol3d": [
            read(path, path.with_name(path.name.replace("FrameBuffer", "Depth")))
            for path in sorted(data.glob("simcol3d/FrameBuffer_*.png"))
        ],
        "sinus": [read(path) for path in sorted(data.glob("sinus/*.jpg"))],
    }
    return {name: pictures for name, pictures in found.items() if pictures}


def film(config: PhantomConfig, frames: int) -> list[Picture]:
    """Some frames spread over the scene's whole path; the gain is free, since neighbours are far apart."""
    imaging = replace(config.imaging, exposure_smoothing=0.0, shutter=0.0)
    camera = replace(config.camera, width=SIZE, height=SIZE)
    phantom = Phantom(replace(config, imaging=imaging, camera=camera), threads=1)
    poses = write_script(phantom).poses
    chosen = poses[np.linspace(0, len(poses) - 1, frames).round().astype(int)]
    return [Picture(frame.image, frame.depth) for frame in phantom.film(chosen)]


def phantom_sources(seeds: int, frames: int) -> dict[str, list[Picture]]:
    """Frames of every named scene, by name."""
    return {
        f"phantom {name}": [picture for seed in range(seeds) for picture in film(scene_config(name, seed), frames)]
        for name in SCENES
    }


def shown_area(pictures: list[Picture]) -> np.ndarray:
    """True (S,S) where a source ever shows anything: masks of processors are black in all frames."""
    brightest = np.max([picture.image.max(axis=2) for picture in pictures], axis=0)
    solid = cv2.morphologyEx((brightest > 24).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    return cv2.erode(solid, np.ones((7, 7), np.uint8), borderValue=1).astype(bool)


def gradients(image: np.ndarray) -> np.ndarray:
    """Length of the luma's gradient (S,S), grey levels per pixel, by central differences."""
    luma = cv2.cvtColor(image.astype(np.float32), cv2.COLOR_RGB2GRAY)  # whole grey levels would quantise it
    return np.hypot(*np.gradient(luma))


def statistics(picture: Picture, area: np.ndarray) -> dict[str, float]:
    """One picture's figures, keyed as COLUMNS; those that need depth are missing without it."""
    image, hsv = picture.image, cv2.cvtColor(picture.image.astype(np.float32) / 255, cv2.COLOR_RGB2HSV)
    brightest = image.max(axis=2).astype(float)
    turns = np.exp(1j * np.radians(hsv[..., 0][area])) * hsv[..., 1][area]  # grey has no hue
    figures = {
        "gradient": float(np.median(gradients(image)[area])),
        "keypoints": float(len(SIFT.detect(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), area.astype(np.uint8)))),
        "brightness": float(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[area].mean()),
        "saturation": float(100 * hsv[..., 1][area].mean()),
        "hue": float((np.degrees(np.angle(turns.mean())) + 180) % 360 - 180),
        "clipped": float(100 * (brightest[area] >= 254).mean()),
    }
    if picture.depth is not None:
        seen = area & (picture.depth > 0)
        seen[np.arange(SIZE) % 3 > 0] = False
        figures["rank"] = float(spearmanr(brightest[seen], picture.depth[seen]).statistic)
        fit = seen & (brightest < 250) & (brightest > 8)
        linear = GAMMA * np.log(brightest[fit])
        figures["slope"] = float(np.polyfit(np.log(picture.depth[fit]), linear, 1)[0])
    return figures


def describe(pictures: list[Picture]) -> tuple[dict, np.ndarray]:
    """Spread of every figure over a source's pictures, and the pooled histogram of gradients."""
    area = shown_area(pictures)
    rows = [statistics(picture, area) for picture in pictures]
    figures = {key: spread([row[key] for row in rows]) for key in COLUMNS if key in rows[0]}
    histogram = sum(np.histogram(gradients(picture.image)[area], BINS)[0] for picture in pictures)
    return {"frames": len(pictures), **figures}, histogram / histogram.sum()


def own_halves(pictures: list[Picture]) -> float:
    """Wasserstein-1 between a source's first and second half: what distance is nothing to speak of."""
    middle = len(pictures) // 2
    halves = {"first": describe(pictures[:middle])[1], "second": describe(pictures[middle:])[1]}
    return distances(halves)["first | second"]


def distances(histograms: dict[str, np.ndarray]) -> dict[str, float]:
    """Wasserstein-1 between the gradient histograms of every two sources, grey levels per pixel."""
    middles = 0.5 * (BINS[1:] + BINS[:-1])
    return {
        f"{one} | {other}": float(wasserstein_distance(middles, middles, histograms[one], histograms[other]))
        for one, other in combinations(histograms, 2)
    }


def draw_sheet(sources: dict[str, list[Picture]], path: Path) -> None:
    """A row of pictures for every source, its name in the corner."""
    rows = []
    for name, pictures in sources.items():
        chosen = np.linspace(0, len(pictures) - 1, SHOWN).round().astype(int)
        row = np.hstack([pictures[index].image for index in chosen])
        cv2.putText(row, name, (6, SIZE - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 3, cv2.LINE_AA)
        cv2.putText(row, name, (6, SIZE - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 1, cv2.LINE_AA)
        rows.append(row)
    cv2.imwrite(str(path), np.vstack(rows)[..., ::-1])


def print_table(described: dict[str, dict], apart: dict[str, float]) -> None:
    """Median [least, most] of every figure; then the distances."""
    print(f"{'':24}{'frames':>7}" + "".join(f"{key:>23}" for key in COLUMNS))
    for name, figures in described.items():
        cells = [
            f"{f['median']:.2f} [{f['min']:.2f}, {f['max']:.2f}]" if (f := figures.get(key)) else "-" for key in COLUMNS
        ]
        print(f"{name:24}{figures['frames']:>7}" + "".join(f"{cell:>23}" for cell in cells))
    print("\nWasserstein-1 of gradient histograms, grey levels/px")
    for pair, value in apart.items():
        print(f"  {pair:46}{value:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", type=Path, help="folder with ctcolon, simcol3d, sinus; what is missing is left out")
    parser.add_argument(
        "--seeds", type=int, default=4, help="colons per scene; four show ccd's every material and light"
    )
    parser.add_argument("--frames", type=int, default=6, help="frames per colon")
    parser.add_argument("--sheet", type=Path, help="write a PNG to look at")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    sources = {**real_sources(arguments.data), **phantom_sources(arguments.seeds, arguments.frames)}
    described, histograms = {}, {}
    for name, pictures in sources.items():
        described[name], histograms[name] = describe(pictures)
    apart = distances(histograms) | {f"{name} | its own other half": own_halves(p) for name, p in sources.items()}
    print_table(described, apart)
    if arguments.sheet:
        draw_sheet(sources, arguments.sheet)
    write(arguments.json, {"columns": COLUMNS, "sources": described, "gradient_distance": apart})


if __name__ == "__main__":
    main()
