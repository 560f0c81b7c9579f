"""What `clt observability` says to people."""

from __future__ import annotations

import numpy as np

from clt.observability.exact.analysis import Analysis
from clt.observability.windows.windows import RobotWindows, WindowAnalysis

MAX_DIRECTIONS = 12
"""Unobservable directions printed; --json has all."""
UNOBSERVABLE_TITLE = "no range observes:"
SECOND_ORDER_TITLE = "observed only to second order, next to nothing while the team stays so:"


def print_analysis(found: Analysis, *, verbose: bool) -> None:
    """Rank, open directions, mirror images and remedies on standard output."""
    nodes = found.setup.nodes
    moving = sum(not node.static for node in nodes)
    known = sum(node.known for node in nodes)
    static = len(nodes) - moving
    place = f" ({known} of known position)" if static > 0 and found.setup.ego is None else ""
    frame = "the world"
    if found.setup.ego is not None:
        frame = f"the body frame of {nodes[found.setup.ego].name}"
    elif found.setup.framed:
        first, second = (nodes[k].name for k in found.setup.frame_robots)
        frame = f"the world that {first} and {second} span"
    noun = "robot" if static == 1 else "robots"
    print(f"{moving} moving and {static} static {noun}{place}, in {frame}")
    verdict = "observable" if found.observable else "NOT observable"
    print(
        f"{verdict}: rank {found.rank} of {found.dimension}, nullity {found.nullity} "
        f"(Lie derivatives up to order {found.order})"
    )
    for title, hidden in ((UNOBSERVABLE_TITLE, True), (SECOND_ORDER_TITLE, False)):
        names = [one.name for one in found.unobservable if one.hidden is hidden]
        print_section(title, names[:MAX_DIRECTIONS])
        if len(names) > MAX_DIRECTIONS:
            print(f"  and {len(names) - MAX_DIRECTIONS} more (--json)")
    if verbose:
        for direction in found.unobservable[:MAX_DIRECTIONS]:
            print_section(
                f"{direction.name}, as a vector:",
                [f"{name} {value:+.4g}" for name, value in direction.components.items()],
            )
    count = "" if found.solutions is None else f" ({found.solutions} solutions in all)"
    print_section(f"no range excludes{count}:", list(found.ambiguities))
    cures = [
        remedy.text + ("" if remedy.nullity == 0 else f" (nullity {remedy.nullity} remains)")
        for remedy in found.remedies
    ]
    print_section("what would help, any one of:" if len(cures) > 1 else "what would help:", cures)


def print_section(title: str, lines: list[str]) -> None:
    """A title and its indented lines, or nothing."""
    if len(lines) > 0:
        print(title)
    for line in lines:
        print(f"  {line}")


def print_windows(found: WindowAnalysis) -> None:
    """One line per robot over all windows."""
    length = float(found.end[0] - found.begin[0])
    full = int(np.sum(found.rank == found.dimension))
    print(
        f"\n{found.rank.size} windows of {length:g} s, at the {found.source.replace('_', ' ')}: "
        f"full rank {found.dimension} in {full}"
    )
    width = max((len(name) for name in found.robots), default=0)
    for name, seen in found.robots.items():
        print(f"  {name:{width}}  {robot_windows_text(seen)}")


def robot_windows_text(seen: RobotWindows) -> str:
    """Ranks, best standard deviations and the usual weakest direction of one robot."""
    size = 2 if np.isnan(seen.sigma_heading).all() else 3
    parts = [
        f"rank {rank_text(seen)} of {size}",
        f"position {sigma_text(seen.sigma_position, 'm')}",
    ]
    if size == 3:
        parts.append(f"heading {sigma_text(seen.sigma_heading, 'rad')}")
    words, counts = np.unique(np.array(seen.words), return_counts=True)
    parts.append(f"weakest: {words[int(np.argmax(counts))]}")
    return "; ".join(parts)


def rank_text(seen: RobotWindows) -> str:
    """The rank, or its least and greatest."""
    low, high = int(np.min(seen.rank)), int(np.max(seen.rank))
    return str(low) if low == high else f"{low} .. {high}"


def sigma_text(sigma: np.ndarray[tuple[int], np.dtype[np.float64]], unit: str) -> str:
    """Median and worst of the best standard deviations."""
    if not np.isfinite(sigma).any():
        return "unknown"
    worst = f"{np.max(sigma):.3g}" if np.isfinite(sigma).all() else "unknown"
    return f"{np.median(sigma[np.isfinite(sigma)]):.3g} {unit} (worst {worst})"
