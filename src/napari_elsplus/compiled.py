"""Compiled kernels that release the GIL.

The only place that speaks to numba's decorator, so that every kernel is compiled alike: no Python objects, no GIL,
kept on disk between runs where the disk allows it.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numba

if TYPE_CHECKING:
    from collections.abc import Callable

    Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile a function to machine code that runs without the GIL.

    The compiled code is cached beside the source, or in the user's cache folder; where neither can be written it is
    compiled anew in each process.
    """
    compile_with = partial(numba.njit, nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz", "reassoc"})
    try:
        return cast("Function", compile_with(cache=True)(function))
    except RuntimeError:  # numba's word for "no folder in which the cache could be written"
        return cast("Function", compile_with()(function))
