"""Compilation of internal kernels to LLVM's intermediate code only, for kernels that other kernels call.

numba optimises each function together with all that it calls, and makes machine code of it, so that a callee's code is
gone through once for every function above it. Only the entry points are called from Python. Left to them, optimising
takes half the time, and the same machine code comes out.
"""

from __future__ import annotations

import numba
from numba import _dynfunc, njit
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.typed_passes import NativeLowering

from bus.kernel_cache.processor import set_level

set_level()  # before numba's first use: it asks for the processor once

TRIED = ((0, 62), (0, 68))
"""First and last version of numba that callee compilation was tried with: it overrides methods that may change. Other
versions compile every kernel in full, to the same bits."""


UNUSED = {
    "WithLifting",
    "InlineClosureLikes",
    "RewriteDynamicRaises",
    "MakeFunctionToJitFunction",
    "InlineInlinables",
    "FindLiterallyCalls",
    "LiteralUnroll",
    "LiteralPropagationSubPipelinePass",
    "InlineOverloads",
    "NopythonRewrites",
    "DumpParforDiagnostics",
}
"""Passes for what no kernel has: closures, ``with``, exceptions, literals asked for, array expressions. After each of
them numba analyses the function's variables again."""


class CalleeLibrary(JITCodeLibrary):
    """Intermediate code of a kernel, for its callers to link in."""

    def _optimize_final_module(self):
        """Leave optimising to the entry point that the kernel ends up in."""

    def _finalize_final_module(self):
        """Make no machine code."""
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class CalleeLowering(NativeLowering):
    """Compiler pass that lowers a kernel to intermediate code and registers it with its callers."""

    _name = "callee_lowering"

    def run_pass(self, state):
        """Lower ``state``'s function; as ``NativeLowering`` but for the machine code."""
        library = CalleeLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        library.enable_object_caching()
        state.library = library
        state.flags.no_compile = True
        super().run_pass(state)
        library.finalize()
        lowered = state["cr"]
        name = lowered.fndesc.qualname.rpartition(".")[2]
        # numba knows compiled functions by such an object; without a wrapper's address nobody can call it
        function = _dynfunc.make_function(
            lowered.fndesc.lookup_module(), name, f"kernel {name!r}", 0, lowered.env, (library,)
        )
        state.targetctx.insert_user_function(function, lowered.fndesc, [library])
        state["cr"] = lowered._replace(cfunc=function)
        return True


class CalleeFlags(Flags):
    """Compiler options with a fast comparison, by set values: numba looks options up for every operator."""

    def __hash__(self):
        return hash(CalleeFlags)

    def __eq__(self, other):
        if isinstance(other, CalleeFlags):
            return self._values == other._values
        return super().__eq__(other)


class CalleeCompiler(CompilerBase):
    """numba's compiler with ``CalleeLowering`` in the place of ``NativeLowering``, and without ``UNUSED`` passes."""

    def __init__(self, typingctx, targetctx, library, args, return_type, flags, locals):  # noqa: A002 - numba's name
        flags = CalleeFlags(flags)
        super().__init__(typingctx, targetctx, library, args, return_type, flags, locals)

    def define_pipelines(self):
        """List the passes."""
        manager = PassManager("callee")
        for define in (
            DefaultPassBuilder.define_untyped_pipeline,
            DefaultPassBuilder.define_typed_pipeline,
            DefaultPassBuilder.define_nopython_lowering_pipeline,
        ):
            manager.passes += [
                (CalleeLowering if one is NativeLowering else one, why)
                for one, why in define(self.state).passes
                if one.__name__ not in UNUSED
            ]
        manager.finalize()
        return [manager]


_PIPELINE = {"pipeline_class": CalleeCompiler} if TRIED[0] <= numba.version_info[:2] <= TRIED[1] else {}

_OPTIONS = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}

kernel = njit(**_OPTIONS, **_PIPELINE)
"""Decorator of a kernel that other kernels call. No fused multiply-add, no reordering (``fastmath`` off): the same bits
on every run. No wrappers for calls from Python: they would double the compiling time. No reference counts (``_nrt``):
kernels allocate nothing, and counting cost a fifth of the time."""

inlined = njit(forceinline=True, **_OPTIONS, **_PIPELINE)
"""Decorator of a kernel that becomes part of each caller. A call's arguments go through memory, seven numbers an
array: with thirty arrays that takes as long as a cell's tick."""
