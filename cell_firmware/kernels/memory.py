"""Arrays at addresses: what stays in one place between ticks is handed to a kernel as one record of addresses.

Each array that Python hands to a kernel costs some 0.2 µs, and a shard has thirty.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array


def entry_address(function: Any) -> int:
    """Return the address of an entry point whose arguments and result are int64, for ``call_at``."""
    (compiled,) = function.overloads.values()
    return compiled.library.get_pointer_to_function(compiled.fndesc.llvm_cfunc_wrapper_name)


@intrinsic
def array_at(_context, _address, shape, kind):
    """Return the array that lies at an address, in one piece, as ``numba.carray`` without the call.

    Args:
        address: int64; the array's owner keeps it alive.
        shape: One number or several.
        kind: A NumPy dtype.
    """
    dimensions = 1 if isinstance(shape, types.Integer) else shape.count
    array_type = types.Array(kind.dtype, dimensions, "C")

    def generate(context, builder, signature, arguments):
        data = builder.inttoptr(arguments[0], context.get_data_type(kind.dtype).as_pointer())
        return _array(context, builder, array_type, data, signature.args[1], arguments[1])

    return array_type(types.int64, shape, kind), generate


@intrinsic
def on_stack(_context, kind):
    """Return an array of one item in the caller's own memory, of any bytes.

    Nothing else points there, as long as no function that isn't inlined is given it: what was written can stay in
    registers, and isn't read again after every write elsewhere.

    Args:
        kind: A NumPy dtype.
    """
    array_type = types.Array(kind.dtype, 1, "C")

    def generate(context, builder, _signature, _arguments):
        data_type = context.get_data_type(kind.dtype)
        with builder.goto_entry_block():
            memory = builder.alloca(data_type)
            memory.align = 16
        size = context.get_constant(types.intp, context.get_abi_sizeof(data_type))
        array = make_array(array_type)(context, builder)
        one = context.get_constant(types.intp, 1)
        populate_array(array, data=memory, shape=[one], strides=[size], itemsize=size, meminfo=None)
        return array._getvalue()  # noqa: SLF001 - so are all of numba's structures read

    return array_type(kind), generate


@intrinsic
def part_of(_context, array, start, shape, kind):
    """Return the array that begins at a byte of an array.

    Args:
        array: Array in one piece.
        start: Byte at which the part begins.
        shape: One number or several.
        kind: A NumPy dtype.
    """
    dimensions = 1 if isinstance(shape, types.Integer) else shape.count
    array_type = types.Array(kind.dtype, dimensions, "C")

    def generate(context, builder, signature, arguments):
        whole = context.make_array(signature.args[0])(context, builder, arguments[0])
        byte = ir.IntType(8).as_pointer()
        place = builder.gep(builder.bitcast(whole.data, byte), [arguments[1]])
        data = builder.bitcast(place, context.get_data_type(kind.dtype).as_pointer())
        return _array(context, builder, array_type, data, signature.args[2], arguments[2])

    return array_type(array, start, shape, kind), generate


def _array(context, builder, array_type, data, shape_type, shape):
    """Build an array in one piece."""
    lengths = [shape] if array_type.ndim == 1 else cgutils.unpack_tuple(builder, shape)
    kinds = [shape_type] if array_type.ndim == 1 else list(shape_type)
    lengths = [
        context.cast(builder, length, kind, types.intp) for length, kind in zip(lengths, kinds, strict=True)
    ]
    array = make_array(array_type)(context, builder)
    size = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(array_type.dtype)))
    strides = [size]
    for length in reversed(lengths[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    populate_array(array, data=data, shape=lengths, strides=strides, itemsize=size, meminfo=None)
    return array._getvalue()  # noqa: SLF001 - so are all of numba's structures read


@intrinsic
def address_of(_context, array):
    """Return the address of an array in one piece."""

    def generate(context, builder, signature, arguments):
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        return builder.ptrtoint(array.data, context.get_value_type(types.int64))

    return types.int64(array), generate


@intrinsic
def call_at(_context, address, arguments):
    """Call a function of Python's entry points by its address (``entry_address``); it takes and returns int64.

    What is called so is compiled once, and not with each program: a program's kernels are compiled whenever its author
    changes it.

    Args:
        address: Of the function.
        arguments: Tuple of int64.
    """

    def generate(context, builder, signature, given):
        address, values = given
        word = context.get_value_type(types.int64)
        words = [
            context.cast(builder, value, kind, types.int64)
            for value, kind in zip(
                cgutils.unpack_tuple(builder, values), signature.args[1].types, strict=True
            )
        ]
        kind = ir.FunctionType(word, [word] * len(words))
        return builder.call(builder.inttoptr(address, kind.as_pointer()), words)

    return types.int64(address, arguments), generate


@intrinsic
def copy_memory(_context, source, target):
    """Copy as many bytes as ``target`` has from ``source``, which lies elsewhere.

    A loop over bytes has to look whether they overlap; the compiler copies a few at a time only without.

    Args:
        source: Array in one piece.
        target: Array in one piece, of no more bytes; is filled.
    """

    def generate(context, builder, signature, arguments):
        there, here = (
            context.make_array(kind)(context, builder, value)
            for kind, value in zip(signature.args, arguments, strict=True)
        )
        cgutils.raw_memcpy(builder, here.data, there.data, here.nitems, here.itemsize)
        return context.get_dummy_value()

    return types.none(source, target), generate


@intrinsic
def move_memory(_context, source, target):
    """Copy as ``copy_memory``, from a source that may overlap the target."""

    def generate(context, builder, signature, arguments):
        there, here = (
            context.make_array(kind)(context, builder, value)
            for kind, value in zip(signature.args, arguments, strict=True)
        )
        cgutils.raw_memmove(builder, here.data, there.data, here.nitems, here.itemsize)
        return context.get_dummy_value()

    return types.none(source, target), generate


@intrinsic
def clear_memory(_context, target):
    """Make all bytes of an array in one piece zero."""

    def generate(context, builder, signature, arguments):
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        size = builder.mul(array.nitems, array.itemsize)
        cgutils.memset(builder, array.data, size, 0)
        return context.get_dummy_value()

    return types.none(target), generate
