"""The one exception for everything that can be wrong with a scenario source."""

from __future__ import annotations


class ScenarioError(ValueError):
    """A scenario source cannot be used; the message is one line: what is wrong, where, and what to do."""
