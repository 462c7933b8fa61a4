"""Make the pictures of the documents from the real program: all, or those that are named.

python docs/make_pictures.py
python docs/make_pictures.py 4_unwrap window.gif
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib import import_module

from picture_making.saving import PICTURES

#: Who makes which pictures: module and function, which takes the names that are wanted.
MAKERS = {
    ("stills", "stills_of_the_euglena"): (
        "0_empty",
        "1_recording",
        "2_lobes",
        "3_phase",
        "4_unwrap",
        "5_table",
        "tutorial_6_dry_mass",
        "5_trace",
        "5_measure",
        "5_save",
    ),
    ("stills", "stills_of_the_cells"): ("5_cells",),
    ("stills", "still_of_a_live_recording"): ("live",),
    ("stills", "stills_of_the_yeast"): ("6_yeast", "7_steps", "8_trust", "9_difference", "light"),
    ("moving", "moving_picture"): ("window",),
    ("results", "figures_of_the_paper"): ("figure_2", "figure_4"),
    ("results", "figure_of_the_own_method"): ("figure_own",),
    ("results", "figure_of_a_pause"): ("pause",),
    ("results", "figure_of_refocusing"): ("refocusing",),
    ("figure_1", "figure_1"): ("figure_1",),
    ("itoh", "figure_of_itoh"): ("itoh",),
    ("off_axis", "figure_of_off_axis"): ("off_axis",),
    ("architecture", "figure_of_the_rooms"): ("architecture",),
}


def main() -> None:
    known = [name for names in MAKERS.values() for name in names]
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one of {', '.join(known)}")
    given = parser.parse_args().names
    wanted = {name.removesuffix(".png").removesuffix(".gif") for name in given} or set(known)
    if unknown := sorted(wanted - set(known)):
        parser.error(f"no such picture: {', '.join(unknown)}; there are {', '.join(known)}")
    PICTURES.mkdir(exist_ok=True)
    for (module, function), names in MAKERS.items():
        if chosen := wanted & set(names):
            make: Callable[[set[str]], None]
            make = getattr(import_module(f"picture_making.{module}"), function)
            make(chosen)


if __name__ == "__main__":
    main()
