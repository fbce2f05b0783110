"""Vector instructions for kernels, written down where the compiler would not find them by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from llvmlite import ir

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

FLOAT: Final = ir.FloatType()
INT32: Final = ir.IntType(32)
_CONTRACT: Final = ("contract",)
"""Allows that a product and a sum are rounded once."""
_LINE: Final = 16
"""Numbers of float32 in a cache line of 64 bytes."""


class Vectors:
    """Builds instructions on vectors of some length; machines without such vectors use several shorter ones.

    Parameters
    ----------
    builder : llvmlite.ir.IRBuilder
        Of the kernel that is compiled.
    length : int
        Numbers in a vector.
    """

    def __init__(self, builder: Any, length: int) -> None:
        self._builder, self.length = builder, length

    def of(self, kind: Any) -> Any:
        """Return the type of vectors of some numbers.

        Parameters
        ----------
        kind : llvmlite.ir.Type
            Of a number.
        """
        return ir.VectorType(kind, self.length)

    def ramp(self) -> Any:
        """Return 0, 1, 2, ... as float32."""
        return ir.Constant(self.of(FLOAT), [float(k) for k in range(self.length)])

    def spread(self, value: Any) -> Any:
        """Return a vector of one computed number, again and again.

        Parameters
        ----------
        value : llvmlite.ir.Value
            The number, of any type.
        """
        one = self._builder.insert_element(ir.Constant(self.of(value.type), ir.Undefined), value, INT32(0))
        return self.chosen(one, one, [0] * self.length)

    def chosen(self, first: Any, second: Any, places: Iterable[int]) -> Any:
        """Return numbers of two vectors.

        Parameters
        ----------
        first, second : llvmlite.ir.Value
            The vectors, of one type.
        places : iterable of int
            Places of the numbers, counted through both vectors.
        """
        return self._builder.shuffle_vector(first, second, ir.Constant(self.of(INT32), list(places)))

    def fused(self, a: Any, b: Any, c: Any) -> Any:
        """Return a b + c, rounded once where the processor can.

        Parameters
        ----------
        a, b, c : llvmlite.ir.Value
            Vectors of float32.
        """
        return self._builder.fadd(self._builder.fmul(a, b, flags=_CONTRACT), c, flags=_CONTRACT)

    def load(self, data: Any, element: Any) -> Any:
        """Return consecutive numbers of an array.

        Parameters
        ----------
        data : llvmlite.ir.Value
            Pointer to float32.
        element : llvmlite.ir.Value
            Index of the first one.
        """
        place = self._builder.gep(data, [element])
        return self._builder.load(self._builder.bitcast(place, self.of(FLOAT).as_pointer()), align=4)

    def store(self, vector: Any, data: Any, element: Any) -> None:
        """Store a vector as consecutive numbers of an array.

        Parameters
        ----------
        vector : llvmlite.ir.Value
            The vector.
        data : llvmlite.ir.Value
            Pointer to its kind of numbers.
        element : llvmlite.ir.Value
            Index of the first one.
        """
        place = self._builder.gep(data, [element])
        self._builder.store(vector, self._builder.bitcast(place, vector.type.as_pointer()), align=4)


def data_of(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """Return the pointer to the first element of an array that an intrinsic is given.

    Parameters
    ----------
    context, builder : object
        As numba gives them.
    kind : numba.types.Array
        Type of the array.
    array : llvmlite.ir.Value
        The array.
    """
    return context.make_array(kind)(context, builder, array).data


def aligned_zeros(count: int) -> NDArray[np.float32]:
    """Return `count` zeros at a multiple of 64 bytes, the length of a cache line."""
    zeros = np.zeros(count + _LINE, np.float32)
    first = -(zeros.ctypes.data // zeros.itemsize) % _LINE
    return zeros[first : first + count]
