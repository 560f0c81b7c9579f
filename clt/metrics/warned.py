"""What an evaluation has to say besides its figures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EvaluationWarning:
    """Something a user must know about an evaluation."""

    text: str
    partial: bool = False
    """Data was unusable, or an estimate is missing or wrong: the command ends with code 3."""
