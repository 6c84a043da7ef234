"""Configuration of a phantom: every number with its unit and its reason.

Lengths are millimetres, angles degrees, colours linear RGB in [0, 1]. One seed fixes geometry, texture and path.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from typing import Any

from haustra.core.errors import PhantomError

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class AnatomyConfig:
    """Shape of the gut. Defaults: a well inflated transverse colon."""

    scene: str = "colon"  # "colon" (crescents between taeniae) or "small_intestine" (plicae circulares)
    length_mm: float = 300.0  # longer than one sees (about 130 mm), so that views rarely end in the open end
    radius_mm: float = 23.0  # adult lumen diameter is 25 to 60 mm
    radius_variation: float = 0.12  # slow widening and narrowing along the way, fraction of the radius
    bend: float = 0.6  # tightest centreline curvature times radius; 1 would fold the inner wall onto itself
    flexures: int = 2  # places where the bend is reached
    pinch_mm: float = 25.0  # the lumen contracts over this length at both (open) ends
    taenia_depth_mm: float = 1.6  # the three muscle bands pull the wall inwards: triangular cross-section
    taenia_twist_deg_per_mm: float = 0.25  # the bands wind slowly around the lumen
    sacculation_mm: float = 1.8  # outward bulge of a haustrum between its two folds
    fold_spacing_mm: float = 24.0  # haustra are 15 to 40 mm long
    fold_spacing_jitter: float = 0.3  # no two haustra are alike, fraction of the spacing
    fold_depth_mm: float = 8.0  # how far a crescent reaches into the lumen
    fold_depth_jitter: float = 0.35  # fraction of the depth
    fold_width_mm: float = 2.6  # decay length of the fold's flank; small means thin and sharp
    fold_edge_mm: float = 0.7  # rounding of the rim; below the mesh edge it would be faceted
    fold_tilt_mm: float = 5.0  # the crescents are not perpendicular to the lumen
    fold_lean: float = 0.35  # rim leans along the lumen by this fraction of its depth: one-sided occlusion
    relief_mm: float = 0.5  # random undulation of the wall, standard deviation of the largest scale
    polyps: int = 3  # sessile polyps (Paris Is)
    polyp_radius_mm: float = 3.5  # base radius; clinically relevant from 5 mm diameter
    pedunculated: int = 0  # polyps on a stalk (Paris Ip), heads of the same radius
    flat: int = 0  # flat, slightly raised polyps (Paris IIa): wider and hardly a millimetre high
    diverticula: int = 0  # pouches through the muscle, with a neck narrower than the pouch
    diverticulum_mm: float = 3.0  # radius of the mouth
    villi_mm: float = 0.0  # height of the velvet that covers the small intestine
    collapse: float = 0.0  # 0 inflated; towards 1 the lumen is pressed flat in places
    closed_start: bool = False  # a blind end, rounded as the caecum is, instead of a contracted opening
    closed_end: bool = False
    edge_mm: float = 0.8  # mesh edge; finer detail comes from the texture's bump


@dataclass(frozen=True)
class AppearanceConfig:
    """Mucosa as painted on the surface. Colours are reflectances, not what the sensor shows."""

    tissue: Colour = (0.62, 0.23, 0.16)  # pink mucosa
    tissue_other: Colour = (0.70, 0.30, 0.17)  # paler, more orange mucosa it drifts into
    blotch_mm: float = 18.0  # size of the drift between the two
    contrast: float = 1.0  # of reflectance between pale and dark patches: white gallbladder beside dark liver has 5
    mottle: float = 0.055  # relative standard deviation of reflectance at 1.5 to 8 mm
    grain: float = 0.018  # the same at 0.3 to 1.5 mm: what close-ups see
    erythema: float = 0.25  # strength of red patches
    vessel_colour: Colour = (0.55, 0.30, 0.36)  # multiplies the tissue under an opaque vessel
    mesh_vessels: float = 0.7  # opacity of the polygonal submucosal network
    mesh_cell_mm: float = 9.0  # its cell size
    mesh_width_mm: float = 0.55  # its calibre
    tree_vessels: float = 0.75  # opacity of the branching trees
    trees_per_cm2: float = 0.05  # their density
    tree_width_mm: float = 0.6  # calibre of a trunk; twigs go down to one texel
    bump_mm: float = 0.012  # standard deviation of fine relief: breaks glints up, roughens the shading
    cavity: float = 0.35  # darkening in grooves, brightening on crests (stands in for interreflection)
    stool: float = 0.0  # part of the wall under stool: matte, ochre to brown, slightly raised
    stool_colour: Colour = (0.42, 0.27, 0.07)
    fluid: float = 0.0  # part of the wall under a film of turbid fluid: tinted, smooth, glossy
    fluid_colour: Colour = (0.80, 0.62, 0.25)  # multiplies the tissue under an opaque film
    texel_mm: float = 0.13  # texture resolution: a pixel at 20 mm and f = 160 px


@dataclass(frozen=True)
class ImagingConfig:
    """Light at the tip and the chain from radiance to pixel. Zero switches a term off."""

    lights: int = 2  # light guides at the tip
    light_offset_mm: float = 3.5  # from the optical axis; a scope's tip is about 12 mm wide
    light_shift_mm: float = 0.0  # of all lights along x: those of a stereo scope, as its second eye has them
    light_roll_deg: float = 20.0  # where around the tip they sit
    light_lobe: float = 0.2  # exponent of the cosine emission lobe; of 18 measured colonoscopes 1.9 to 3.3
    lobe_tilt_deg: float = 0.0  # angle between the lobe's axis and the optical axis; of those up to 8
    lobe_roll_deg: float = 0.0  # where around the optical axis the lobe leans to; 0 is right, 90 down
    light_colour: Colour = (1.0, 0.96, 0.90)  # xenon, slightly warm after the lens
    ambient: float = 0.16  # light arriving by other walls, relative to direct light at 25 mm: a mere tint
    bounce: float = 0.0  # light that visible walls send each other; 1 as physics has it, further reflections included
    wrap: float = 0.25  # light that subsurface scattering carries round the terminator
    shadows: bool = True  # cast shadows from the off-axis lights
    specular: float = 0.12  # strength of wet glints
    shininess: float = 90.0  # Blinn-Phong exponent of the mucus film
    exposure: float = 0.17  # mean brightness (linear, clipped) the automatic gain aims at
    exposure_smoothing: float = 0.8  # part of the old gain kept each frame (0.8: about 0.2 s at 30 fps)
    fixed_gain: float = 0.0  # factor on radiance without automatic gain, as at a fixed ISO number; 0: automatic
    gain_error: float = 1.0  # factor by which a single shot's automatic gain is late: above 1 it burns
    crosstalk: float = 0.0  # how far colour filters overlap, up to 0.95: then all channels saturate together, to white
    gamma: float = 2.2  # display encoding
    vignette: float = 0.12  # loss of brightness in the corners
    border: str = "none"  # "none", "circle" or "octagon": what the endoscope's processor masks off
    noise: float = 0.006  # sensor noise, standard deviation as fraction of full scale
    blur_px: float = 0.45  # lens and demosaicing; also softens jagged silhouettes
    shutter: float = 0.0  # part of the frame interval the shutter is open: motion blur
    focus_mm: float = 25.0  # distance of sharpest focus
    defocus_px: float = 0.0  # blur at half the focus distance, standard deviation at 320 px width
    sharpen: float = 0.0  # edge enhancement of the video processor: weight of an unsharp mask
    chroma_px: int = 1  # 2 keeps one colour sample for 2x2 pixels (4:2:0)
    jpeg_quality: int = 0  # 1 to 100: blocks and ringing as a recorder leaves them; 0 keeps the picture as it is
    text: bool = False  # burned-in lines such as a processor writes; invented, no patient's
    readout: str = "at_once"  # "interlaced": odd lines half a frame later; "sequential": red, green, blue in turn


@dataclass(frozen=True)
class CameraConfig:
    """Lens by COLMAP's name. Parameters follow from the field of view so that sizes can change."""

    model: str = "PINHOLE"  # "PINHOLE", "OPENCV" or "OPENCV_FISHEYE"
    width: int = 320  # px
    height: int = 320  # px
    fov_deg: float = 90.2  # horizontal, edge to edge; colonoscopes have 100 to 170 over the diagonal
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # k1 k2 p1 p2, or k1..k4 for fisheye
    focal_px: tuple[float, float] = (0.0, 0.0)  # of a measured lens, instead of `fov_deg`; 0 derives it
    centre_px: tuple[float, float] = (0.0, 0.0)  # principal point of a measured lens; 0 is the picture's middle


@dataclass(frozen=True)
class MotionConfig:
    """Motion of the scope."""

    frames: int = 160  # 5.3 s at 30 fps
    fps: float = 30.0
    direction: str = "withdrawal"  # looks ahead and backs out; "insertion" moves forward; "loop" goes in and returns
    start: float = 0.55  # where along the lumen it begins, fraction of the length
    speed_mm: float = 0.5  # per frame; withdrawal is 5 to 30 mm/s
    speed_variation: float = 0.35  # relative
    wobble_mm: float = 4.0  # lateral swing
    wobble_period: float = 70.0  # frames per swing
    look_deg: float = 12.0  # look-around about the lumen direction
    roll_deg: float = 8.0  # twist of the shaft
    ahead_mm: float = 25.0  # the tip looks at the centreline this far ahead
    clearance_mm: float = 3.5  # nearest approach of the lens to the wall
    pauses: int = 0  # times the scope rests
    touches: int = 0  # times the tip comes within `touch_mm` of the wall
    touch_mm: float = 1.2  # gap that is left between lens and wall
    quick_turns: int = 0  # sudden swings of the view and back
    quick_turn_deg: float = 35.0
    look_backs: int = 0  # times the tip bends round to look behind a fold, and returns
    look_back_deg: float = 110.0
    manoeuvre_s: float = 1.0  # length of each of these; a look-back takes three
    recording: str = ""  # TUM file of a real hand's motion (mm) to replay along the lumen, instead of all above


@dataclass(frozen=True)
class EventsConfig:
    """Events in front of the lens: how many, and how long. Depth and mesh stay exact during them."""

    red_outs: int = 0  # mucosa covers the lens: nothing can be measured
    water_jets: int = 0  # rinsing: a spray from the tip hides part of the wall
    bubbles: int = 0  # foam on the wall
    tools: int = 0  # a forceps comes out of its channel and goes back
    peristalsis: int = 0  # a contraction runs along the wall: the mesh itself moves
    duration_s: float = 1.0  # of each event
    contraction: float = 0.35  # part of the radius that peristalsis takes away


@dataclass(frozen=True)
class TissueConfig:
    """Motion of the whole wall all the time: contractions, breathing, insufflation, the tip's push."""

    amplitude_mm: float = 0.0  # about the largest displacement from rest; 0 keeps the wall still
    wave_speed_mm_s: float = 20.0  # of contractions along the gut
    breath_s: float = 4.0  # period
    insufflation_s: float = 13.0  # period of widening and narrowing by gas


@dataclass(frozen=True)
class PhantomConfig:
    """All settings of a phantom. The same config gives the same bytes."""

    seed: int = 0
    anatomy: AnatomyConfig = field(default_factory=AnatomyConfig)
    appearance: AppearanceConfig = field(default_factory=AppearanceConfig)
    imaging: ImagingConfig = field(default_factory=ImagingConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    events: EventsConfig = field(default_factory=EventsConfig)
    tissue: TissueConfig = field(default_factory=TissueConfig)

    def to_dict(self) -> dict[str, Any]:
        """Nested plain dict of numbers, strings and lists, fit for YAML."""
        return _plain(asdict(self))

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> PhantomConfig:
        """Inverse of `to_dict`; missing keys take the default. PhantomError on unknown keys and wrong types."""
        return cls().updated(values)

    def updated(self, values: dict[str, Any]) -> PhantomConfig:
        """This config with some (nested) values replaced. PhantomError on unknown keys and wrong types."""
        return _updated(self, values)


def _plain(value: Any) -> Any:
    """The value with tuples as lists, recursively."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def _updated(held: Any, values: Any) -> Any:
    """A config with the (nested) values of a mapping; PhantomError on unknown keys and wrong types."""
    name = type(held).__name__
    if not isinstance(values, dict):
        raise PhantomError(f"{name}: expected a mapping, got {values!r}")
    known = {f.name for f in fields(held)}
    if unknown := sorted(str(key) for key in set(values) - known):
        raise PhantomError(f"unknown {name} keys: {', '.join(unknown)}; known: {', '.join(sorted(known))}")
    return replace(held, **{key: _restored(f"{name}.{key}", getattr(held, key), v) for key, v in values.items()})


def _restored(name: str, held: Any, value: Any) -> Any:
    """The value as the type of the one it replaces; PhantomError names the field where that cannot be."""
    if is_dataclass(held):
        return _updated(held, value)
    if isinstance(held, float) and type(value) is int:
        return float(value)
    if isinstance(held, tuple) and isinstance(value, list | tuple):
        if len(value) == len(held) and all(type(item) in (int, float) for item in value):
            return tuple(float(item) for item in value)
    elif type(value) is type(held):
        return value
    wanted = f"{len(held)} numbers" if isinstance(held, tuple) else type(held).__name__
    raise PhantomError(f"{name}: expected {wanted}, got {value!r}")
