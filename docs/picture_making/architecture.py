"""The rooms of the code and who imports whom, read from the source itself."""

from __future__ import annotations

import ast
import itertools
import random
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

import napari_phase4d
from picture_making.saving import save_figure

PACKAGE = Path(napari_phase4d.__file__).parent
#: What Python starts, which holds nothing.
LEFT_OUT = {"__init__", "__main__"}
#: Of a room and between rows, in the units of the drawing.
WIDTH, HEIGHT, ROW, COLUMN = 2.4, 0.88, 1.35, 2.6
#: Rooms next to each other, and how long and how wildly good places are looked for.
N_COLUMNS, STEPS, HEAT = 4, 40_000, 4.0
#: Only these may know Qt and napari.
GUI = {"napari", "qtpy"}

Rooms = Mapping[str, set[str]]
Places = dict[str, tuple[float, float]]


def figure_of_the_rooms(wanted: set[str]) -> None:
    """Draw the rooms, lowest at the bottom, with an arrow to each room that is imported."""
    rooms = {room: imports_of(room) for room in names_of_rooms()}
    arrows = without_shortcuts(rooms)
    places = arranged(rooms, arrows)
    left, right = (end(x for x, _ in places.values()) for end in (min, max))
    left, right = left - WIDTH / 2 - 0.1, right + WIDTH / 2 + 0.1
    top = max(y for _, y in places.values())
    edge = HEIGHT / 2 + 0.1
    figure = Figure(figsize=(0.92 * (right - left), 0.82 * (top + 2 * edge)))
    axis = figure.add_axes((0, 0, 1, 1))
    axis.set_xlim(left, right)
    axis.set_ylim(-edge, top + edge)
    axis.set_axis_off()
    for room, imported in arrows.items():
        for other in imported:
            show_arrow(axis, places[room], places[other])
    for room, place in places.items():
        show_room(axis, room, place)
    save_figure(figure, *wanted)


def names_of_rooms() -> list[str]:
    """Return the folders and files right under the package."""
    found = {path.stem for path in PACKAGE.glob("*.py")}
    found |= {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    return sorted(found - LEFT_OUT)


def files_of(room: str) -> list[Path]:
    """Return the files of a room, the one that says what it holds first."""
    folder = PACKAGE / room
    return sorted(folder.rglob("*.py")) if folder.is_dir() else [PACKAGE / f"{room}.py"]


def imports_of(room: str) -> set[str]:
    """Return the other rooms that a room imports."""
    found = {
        name.split(".")[1] for name in modules_of(room) if name.startswith(f"{PACKAGE.name}.")
    }
    return found - {room}


def modules_of(room: str) -> Iterator[str]:
    """Yield the names of all modules that a room imports."""
    for path in files_of(room):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module == PACKAGE.name:
                yield from (f"{node.module}.{alias.name}" for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                yield node.module


def below(room: str, rooms: Rooms) -> set[str]:
    """Return all rooms that a room reaches by imports of imports."""
    return rooms[room].union(*(below(other, rooms) for other in rooms[room]))


def without_shortcuts(rooms: Rooms) -> dict[str, set[str]]:
    """Leave out imports that follow from others (the transitive reduction)."""
    return {
        room: {
            other
            for other in imported
            if not any(other in below(third, rooms) for third in imported)
        }
        for room, imported in rooms.items()
    }


def level(room: str, rooms: Rooms) -> int:
    """Return how many rooms at most lie below a room, one on the other."""
    return 1 + max((level(other, rooms) for other in rooms[room]), default=-1)


def arranged(rooms: Rooms, arrows: Rooms) -> Places:
    """Return the middle of every room, each above all that it imports, with few crossings.

    Rooms are moved and swapped by chance, at first also for the worse (simulated annealing).
    """
    rows: dict[int, list[str]] = {}
    for room in rooms:
        rows.setdefault(level(room, rooms), []).append(room)
    places = {
        room: (COLUMN * (n - (len(row) - 1) / 2), ROW * height)
        for height, row in rows.items()
        for n, room in enumerate(row)
    }
    halves = range(-(N_COLUMNS - 1), N_COLUMNS)
    slots = [(COLUMN * half / 2, ROW * height) for half in halves for height in rows]
    chance = random.Random(1)
    cost = tangle(places, arrows)
    best, least = places, cost
    for step in range(STEPS):
        tried = moved(places, chance.choice(list(places)), chance.choice(slots))
        new_cost = tangle(tried, arrows)
        if new_cost < cost + HEAT * (1 - step / STEPS) * chance.expovariate(1):
            places, cost = tried, new_cost
        if cost < least:
            best, least = places, cost
    return best


def moved(places: Places, room: str, slot: tuple[float, float]) -> Places:
    """Put a room somewhere else; a room that is there takes its place."""
    there = next((other for other, place in places.items() if overlap(place, slot)), None)
    swapped = {} if there is None else {there: places[room]}
    return places | swapped | {room: slot}


def overlap(one: tuple[float, float], two: tuple[float, float]) -> bool:
    """Say whether two rooms touch."""
    return one[1] == two[1] and abs(one[0] - two[0]) < COLUMN


def tangle(places: Places, arrows: Rooms) -> float:
    """Return how bad an arrangement is: what crosses what, what is long, what is impossible."""
    lines = [(places[a], places[b]) for a, others in arrows.items() for b in others]
    impossible = sum(b[1] >= a[1] for a, b in lines)
    impossible += sum(overlap(a, b) for a, b in itertools.combinations(places.values(), 2))
    crossings = sum(
        len({*one, *two}) == 4 and cross(*one, *two)
        for one, two in itertools.combinations(lines, 2)
    )
    through = sum(
        passes(*line, place) for line in lines for place in places.values() if place not in line
    )
    length = sum(abs(a[0] - b[0]) / COLUMN + abs(a[1] - b[1]) / ROW for a, b in lines)
    return 50 * impossible + crossings + 8 * through + 0.2 * length


def cross(a: Any, b: Any, c: Any, d: Any) -> bool:
    """Say whether the lines from a to b and from c to d cross."""

    def side(p: Any, q: Any, r: Any) -> bool:
        return bool((q[0] - p[0]) * (r[1] - p[1]) > (q[1] - p[1]) * (r[0] - p[0]))

    return side(a, c, d) != side(b, c, d) and side(a, b, c) != side(a, b, d)


def passes(start: Any, end: Any, middle: Any) -> bool:
    """Say whether a line passes through the room round a middle."""
    (x0, y0), (x1, y1), (x, y) = start, end, middle
    if not min(y0, y1) < y < max(y0, y1):
        return False
    heights = (y - HEIGHT / 2, y + HEIGHT / 2)
    return any(
        abs(x0 + (x1 - x0) * (height - y0) / (y1 - y0) - x) < WIDTH / 2 for height in heights
    )


def show_arrow(axis: Any, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Draw an arrow from the foot of a room to the head of another."""
    (x0, y0), (x1, y1) = start, end
    lean = 0.16 * max(min(x1 - x0, 3), -3)
    axis.annotate(
        "",
        (x1 - lean, y1 + HEIGHT / 2),
        (x0 + lean, y0 - HEIGHT / 2),
        arrowprops={"arrowstyle": "-|>", "color": "0.35", "lw": 1.2, "shrinkA": 0, "shrinkB": 1},
    )


def show_room(axis: Any, room: str, place: tuple[float, float]) -> None:
    """Draw a room with its name and the first line of what it says of itself."""
    x, y = place
    windowed = any(name.split(".")[0] in GUI for name in modules_of(room))
    corner = (x - WIDTH / 2 + 0.06, y - HEIGHT / 2 + 0.06)
    box = {"boxstyle": "round,pad=0.06", "fc": "#dbe7fb" if windowed else "#f4f1ea", "ec": "0.3"}
    axis.add_patch(FancyBboxPatch(corner, WIDTH - 0.12, HEIGHT - 0.12, **box))
    axis.text(x, y + 0.29, room, ha="center", va="center", fontsize=10, fontweight="bold")
    words = "\n".join(textwrap.wrap(purpose(room), 36))
    axis.text(x, y + 0.16, words, ha="center", va="top", fontsize=7.5, linespacing=1.15)


def purpose(room: str) -> str:
    """Return the first line of a room's docstring."""
    said = ast.get_docstring(ast.parse(files_of(room)[0].read_text(encoding="utf-8")))
    return (said or "").split("\n")[0].rstrip(".")
