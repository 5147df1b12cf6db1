"""Processors that the exported C is compiled for: compilers, emulators, what Debian calls them.

All emulators are QEMU's. In user mode a program reads standard input as here; a Cortex-M has no operating system, and
gets files and output by semihosting. ``machine/`` has the starts of those that need one.
"""

from __future__ import annotations

import os
import shlex
import shutil
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from startracker.errors import InputError

MACHINE = Path(str(files("simulator.study.exported_c") / "machine"))
_PICOLIBC = "/usr/lib/picolibc/riscv64-unknown-elf"


@dataclass(frozen=True)
class Target:
    """Target processor."""

    name: str
    """Description."""
    compiler: str
    size: str = "size"
    symbols: str = "nm"
    """Tool chain: compiler, ``size`` and ``nm``."""
    flags: tuple[str, ...] = ()
    """Compiler options for this processor."""
    machine: tuple[str, ...] = ()
    """Sources of ``machine/`` that the program needs."""
    link: tuple[str, ...] = ()
    """Options of the linker, and after the objects `libraries`."""
    libraries: tuple[str, ...] = ()
    emulator: tuple[str, ...] = ()
    """Emulator with its options; empty: run directly."""
    bare: bool = False
    """Without an operating system: the whole machine is emulated."""
    debian: str = "gcc"
    """Packages of Debian."""

    def missing(self) -> str | None:
        """The first command that is not installed, or None."""
        needed = [self.compiler, self.size, self.symbols, *self.emulator[:1]]
        return next((command for command in needed if shutil.which(command) is None), None)

    def command(self, program: Path, arguments: tuple[str, ...], standard_input: Path, plugin: str = "") -> list[str]:
        """Command that runs a program; a bare machine opens the file of standard input itself.

        Parameters
        ----------
        program : Path
        arguments : tuple of str
            Of the program.
        standard_input : Path
        plugin : str
            Of QEMU, with its options.
        """
        counted = ["-plugin", plugin] if plugin else []
        if not self.bare:
            return [*self.emulator, *counted, str(program), *arguments]
        given = ",".join(f"arg={word}" for word in (program.name, *arguments, str(standard_input)))
        semihosting = ["-semihosting-config", f"enable=on,target=native,{given}"]
        return [*self.emulator, *counted, *semihosting, "-kernel", str(program)]


def _gcc(prefix: str) -> tuple[str, str, str]:
    return f"{prefix}-gcc", f"{prefix}-size", f"{prefix}-nm"


def _cortex_m(name: str, cpu: str, fpu: str, board: str) -> Target:
    return Target(
        name,
        *_gcc("arm-none-eabi"),
        flags=(f"-mcpu={cpu}", "-mthumb", f"-mfpu={fpu}", "-mfloat-abi=hard"),
        machine=("cortex_m.c",),
        link=("-T", str(MACHINE / "cortex_m.ld"), "--specs=rdimon.specs", "-Wl,--wrap=main"),
        emulator=("qemu-system-arm", "-M", board, "-nographic", "-monitor", "none", "-serial", "none"),
        bare=True,
        debian="gcc-arm-none-eabi, libnewlib-arm-none-eabi, qemu-system-arm",
    )


HOST = Target("this machine", "gcc")
CLANG = Target("this machine, Clang", "clang", debian="clang")
M68K = Target(
    "Motorola 68k (CPU32)",
    *_gcc("m68k-linux-gnu"),
    flags=("-mcpu=cpu32",),
    link=("-static",),
    emulator=("qemu-m68k", "-cpu", "m68020"),
    debian="gcc-m68k-linux-gnu, qemu-user",
)
"""The MC68360 of Yee 1999 is a CPU32+, whose instructions run on a 68020."""
CORTEX_M4 = _cortex_m("ARM Cortex-M4 with FPU", "cortex-m4", "fpv4-sp-d16", "mps2-an386")
CORTEX_M7 = _cortex_m("ARM Cortex-M7", "cortex-m7", "fpv5-d16", "mps2-an500")
RISCV64 = Target(
    "RISC-V, 64 bits",
    *_gcc("riscv64-linux-gnu"),
    link=("-static",),
    emulator=("qemu-riscv64",),
    debian="gcc-riscv64-linux-gnu, qemu-user",
)
RISCV32 = Target(
    "RISC-V, 32 bits (RV32IMAC)",
    *_gcc("riscv64-unknown-elf"),
    flags=("-march=rv32imac", "-mabi=ilp32", "-isystem", f"{_PICOLIBC}/include"),
    machine=("riscv32.c",),
    link=("-nostdlib", f"-L{_PICOLIBC}/lib/rv32imac/ilp32"),
    libraries=("-lc", "-lgcc"),
    emulator=("qemu-riscv32",),
    debian="gcc-riscv64-unknown-elf, picolibc-riscv64-unknown-elf, qemu-user",
)
EMULATED = (CORTEX_M4, CORTEX_M7, M68K, RISCV64, RISCV32)
"""All but this machine."""


_COMPILERS = ("cc", "gcc", "clang")


def host_compiler() -> list[str]:
    """Command of this machine's C compiler: that of the variable CC, or the first of cc, gcc and clang that there is.

    Raises
    ------
    InputError
        If there is none, or CC names one that is not installed.
    """
    named = shlex.split(os.environ.get("CC", ""))
    for words in [named] if named else [[name] for name in _COMPILERS]:
        if shutil.which(words[0]) is not None:
            return words
    if named:
        raise InputError(f"CC={named[0]}: there is no such C compiler; install it, or unset CC")
    raise InputError("there is no C compiler here (cc, gcc or clang); install one, or name one by the variable CC")


def native_compiler() -> Target | None:
    """The native compiler, if there is one."""
    for command in ("gcc", "cc"):
        target = Target("this machine", command)
        if target.missing() is None:
            return target
    return None
