"""Hooks of effects in kernels, resolved when a kernel is compiled.

A kernel that an effect may change calls a hook: a function without a body. The implementation follows from the type of
the hook's first argument, a named tuple one of whose fields is None where the effect is absent. One function implements
the hook for None, another for everything else, in a module that only a solver whose scene has the effect imports. So
no kernel tests for effects while it runs, and a kernel without an effect contains none of the effect's code.
"""

from __future__ import annotations

from numba import types
from numba.extending import overload

COMPILED = {"error_model": "numpy", "_nrt": False}
"""As ``jit.kernel`` does."""


def implements(question, *parts, own):
    """Let a function implement a hook for first arguments that have a part of their own, or for those that don't.

    Args:
        question: The function without a body.
        parts: Fields of its first argument.
        own: True: for those that have any of the parts; False: for those that have none.

    Returns:
        A decorator of the function, which takes what the question takes.
    """

    def register(implementation):
        # not strict: the names of arguments that an implementation has no use for need not agree
        @overload(question, jit_options=COMPILED, strict=False)
        def resolve(record, *_):
            fields = dict(zip(record.fields, record.types, strict=True))
            found = any(not isinstance(fields.get(part, types.none), types.NoneType) for part in parts)
            return implementation if found == own else None

        return implementation

    return register
