"""Settings of a filter from all that states some: the log, a file, the environment, options."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from clt.core.settings import parse_settings, set_dotted_key
from clt.model.settings import FilterSettings

if TYPE_CHECKING:
    from clt.core.recording import Communication  # numpy is slow to import


def effective_settings(
    file: tuple[str, Mapping[str, Any]],
    layers: Iterable[tuple[str, Mapping[str, Any]]],
    network: Communication | None = None,
) -> FilterSettings:
    """Defaults, then what the log says of the `network`, the tables of a file, then each layer.

    A file and a layer have the name that an error gives as its source; a layer holds values by
    dotted key. Raises UsageError for keys and values that do not exist.
    """
    name, tables = file
    tree = _checked(dict(tables), name)
    if network is not None:
        tree["dpf"] = network_settings(network) | tree.get("dpf", {})
        tree = _checked(tree, "the log's clt.team")
    for source, values in layers:
        for key, value in values.items():
            set_dotted_key(tree, key, value)
        tree = _checked(tree, source)
    return parse_settings(FilterSettings, tree, name)


def _checked(tree: Mapping[str, Any], source: str) -> dict[str, Any]:
    return parse_settings(FilterSettings, tree, source).model_dump(exclude_unset=True)


def network_settings(network: Communication) -> dict[str, object]:
    """What a log says of the network among its robots as keys of `dpf`."""
    known: dict[str, object] = {
        "graph": network.graph,
        "interval": 1.0 / network.rate,
        "loss": network.loss,
        "delay": network.delay,
    }
    return known if network.reach == float("inf") else known | {"reach": network.reach}
