"""The options of a subject's mattes, which several commands have."""

from __future__ import annotations

import argparse

from .choice import MatteChoice


def add_matte_options(group: argparse._ArgumentGroup) -> None:
    """The options of a subject's mattes."""
    group.add_argument(
        "--masks",
        metavar="DIR",
        help="mattes by camera and frame, DIR/cam00/0000.png or DIR/cam00.mp4: white is subject, black must stay empty "
        "(default: the pictures' own alpha)",
    )
    group.add_argument(
        "--key",
        metavar="C",
        help="key the subject off a screen, green, blue or its colour as R,G,B, and take the spill off",
    )
    group.add_argument(
        "--background-plate",
        metavar="DIR",
        help="a picture of each camera without the subject, DIR/cam00.png: what differs is subject",
    )
    group.add_argument(
        "--ignore",
        metavar="DIR",
        help="a mask of each camera that needs one, DIR/cam00.png: nothing is learnt where it is black",
    )
    group.add_argument(
        "--no-masks",
        dest="own_masks",
        action="store_false",
        help="do without alpha in the pictures and masks that the calibration names",
    )


def matte_choice(options: argparse.Namespace) -> MatteChoice:
    """The choice that these options make."""
    return MatteChoice(options.masks, options.background_plate, options.key, options.ignore, options.own_masks)
