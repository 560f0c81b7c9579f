"""One look for every figure: colours that colour-blind readers can distinguish, quiet axes."""

from __future__ import annotations

from typing import Any, Literal

from matplotlib.axes import Axes

ImageFormat = Literal["png", "svg", "pdf"]
IMAGE_FORMATS: dict[str, ImageFormat] = {".png": "png", ".svg": "svg", ".pdf": "pdf"}
UNDATED_METADATA: dict[ImageFormat, dict[str, None]] = {
    "png": {"Software": None},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
}
"""Nothing in a file may depend on when it was made."""

ROBOT_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Okabe and Ito's palette without black and yellow."""
INK_COLOUR = "#222222"
GREY_COLOUR = "#9a9a9a"
GRID_COLOUR = "#e4e4e4"
ALARM_COLOUR = "#B00020"

RC_PARAMS: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.titlepad": 6,
    "axes.labelsize": 9.5,
    "axes.edgecolor": GREY_COLOUR,
    "axes.labelcolor": INK_COLOUR,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "text.color": INK_COLOUR,
    "text.parse_math": False,
    "xtick.color": INK_COLOUR,
    "ytick.color": INK_COLOUR,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.2,
    "savefig.dpi": 150,
    "svg.hashsalt": "clt",
    "figure.facecolor": "white",
}


def robot_colour(index: int) -> str:
    """Of the robot with this place among the moving ones."""
    return ROBOT_COLOURS[index % len(ROBOT_COLOURS)]


def style_axes(axes: Axes) -> None:
    """A faint grid and short ticks."""
    axes.grid(visible=True, color=GRID_COLOUR, linewidth=0.7)
    axes.tick_params(length=3, width=0.7)
