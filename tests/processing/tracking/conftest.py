"""Every tracking test checks that kernels whose types are resolved once are called with the same types always."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numba
import pytest

from napari_elsplus.processing.tracking.registration import pair_registration

if TYPE_CHECKING:
    from collections.abc import Callable

RESOLVED_ONCE: Final = ("_register", "_score_rotation")
_KINDS: Final[dict[str, tuple[Any, ...]]] = {}


@pytest.fixture(autouse=True)
def _types_are_always_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare the types of arguments at each call with those of the first call of the process, from any test."""
    for name in RESOLVED_ONCE:
        monkeypatch.setattr(pair_registration, name, _compared(name, getattr(pair_registration, name)))


def _compared(name: str, kernel: Callable[..., Any]) -> Callable[..., Any]:
    def call(*arguments: Any) -> Any:
        kinds = tuple(map(numba.typeof, arguments))
        assert _KINDS.setdefault(name, kinds) == kinds
        return kernel(*arguments)

    return call
