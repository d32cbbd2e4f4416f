"""The legend of the 3-D picture: what its colours and signs mean."""

import html
from collections.abc import Collection

from optipromp.core.planning import Plan
from optipromp.core.scenes.scene import Scene
from optipromp.looks.appearance.part import hex_colour
from optipromp.looks.appearance.scene import SEE_THROUGH, colour_of
from optipromp.looks.page.content import GREEN_AT
from optipromp.looks.page.stage import AHEAD, BACK, SIDE, SPREAD, SURE, UNSURE
from optipromp.looks.viewer.drawn import GREEN, PRIMITIVE, RED, motions
from optipromp.perception.overlay import RIPE, STEM, UNRIPE

ROLES = {
    "target": "target",
    "pushable": "may be pushed aside",
    "avoid": "the arm keeps away",
    "static": "fixed, not to be touched",
}
MOST = 3  # colours of one role
_LINES = {
    "conditioned ProMP": "learnt motion",
    "followed path": "way past the fruits",
    "optimised": "tool path",
}

Entry = tuple[str, str]  # sign as HTML, words


def things(scene: Scene) -> list[Entry]:
    """The colours of the scene's objects, one entry a role."""
    found = []
    for role, words in ROLES.items():
        colours = [colour_of(scene, item) for item in scene.objects if item.role == role]
        opacity = SEE_THROUGH if role == "avoid" else 1.0
        signs = "".join(disc(colour, opacity) for colour in list(dict.fromkeys(colours))[:MOST])
        if signs:
            found.append((signs, words))
    return found


def planned(plan: Plan, shown: Collection[str]) -> list[Entry]:
    """The signs of a plan on those of its layers that are shown."""
    found = []
    if "trajectories" in shown:
        lines = list(motions(plan))[::-1]  # the motion itself first
        words = ["tool path", *(_LINES[motion.name] for motion in lines[1:])]
        found += [(line(m.colour), w) for m, w in zip(lines, words, strict=True)]
    if "initial bundle" in shown:
        found.append((disc(PRIMITIVE, SPREAD), "spread of the learnt motion"))
    if "pushed objects" in shown and plan.push_model is not None:
        found.append((label("n, 9 mm"), "predicted push"))
    if "passing sides" in shown and any(plan.metrics.passage.values()):
        found.append((arrow(hex_colour(SIDE)), "side on which it passes"))
    if "candidate paths" in shown and plan.push_model is not None:
        found.append((scale(GREEN, RED), "ways tried: harmless to harmful"))
    if "body spheres" in shown:
        found.append((scale(RED, GREEN), f"arm: touch to {1e3 * GREEN_AT:.0f} mm away"))
    return found


def replayed(*, looks: bool) -> list[Entry]:
    """The signs of an executed plan, ``looks``: of one that looked on its way."""
    found = [(arrow(RED), "force of a touch")]
    if looks:
        found += [
            (line(AHEAD[0]), "way ahead, in the colour of its plan"),
            (line(BACK), "way back"),
            (disc(hex_colour(SURE)), "where it believes a fruit"),
            (disc(hex_colour(UNSURE)), "perhaps a fruit"),
        ]
    return found


def seen() -> list[Entry]:
    """The signs over a picture in which a scene was seen."""
    signs = ((RIPE, "ripe"), (UNRIPE, "unripe"), (STEM, "stem"))
    return [(line(hex_colour(colour)), f"found: {words}") for colour, words in signs]


def legend(entries: Collection[Entry]) -> str:
    """Entries as one block of HTML."""
    items = "".join(
        f'<span style="display:flex;align-items:center;gap:0.35em">'
        f"{sign}{html.escape(words)}</span>"
        for sign, words in entries
    )
    return (
        '<div class="legend" style="display:flex;flex-wrap:wrap;gap:0 0.9em;padding:0.4em 1em;'
        'font-size:0.8em;line-height:1.6">'
        f"{items}</div>"
    )


def disc(colour: str, opacity: float = 1.0) -> str:
    """A thing's colour."""
    return _sign("0.8em", "0.8em", f"border-radius:50%;background:{_seen(colour, opacity)};"
                 f"border:1px solid {colour}")  # fmt: skip


def line(colour: str, opacity: float = 1.0) -> str:
    """A line's colour."""
    return _sign("1.4em", "0.28em", f"background:{_seen(colour, opacity)}")


def scale(first: str, last: str) -> str:
    """Colours from one to another."""
    return _sign("1.8em", "0.28em", f"background:linear-gradient(90deg,{first},#f0c43c,{last})")


def arrow(colour: str) -> str:
    """An arrow's colour."""
    return f'<span style="color:{colour};font-weight:700">→</span>'


def label(words: str) -> str:
    """A label in the picture."""
    return f'<span style="border:1px solid #bbb;padding:0 0.3em;font-size:0.85em">{words}</span>'


def _sign(width: str, height: str, style: str) -> str:
    return (
        f'<span style="display:inline-block;flex:none;box-sizing:border-box;width:{width};'
        f'height:{height};{style}"></span>'
    )


def _seen(colour: str, opacity: float) -> str:
    """A colour with its opacity in two more digits."""
    return f"{colour}{round(255 * opacity):02x}"
