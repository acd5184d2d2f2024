"""What all fleet files of one fleet have to say alike, as a digest: robots compare it before they agree."""

from __future__ import annotations

from agent.kernel.config import Fleet


def common(fleet: Fleet) -> str:
    """Placeholder until the network's part is merged."""
    return ""
