from __future__ import annotations

from fleet.plan.delivery import Delivery


def test_nothing_missing_is_nothing_to_do_or_say() -> None:
    """A plan without a transfer has neither a forecast nor a kind of transfer."""
    nothing = Delivery()
    assert (nothing.steps, nothing.forecast, nothing.transfer) == ((), "", "")
