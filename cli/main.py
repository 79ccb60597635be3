"""Entry point of ``nsfc``: a lazy group of commands, and the one place where errors become exit codes.

Every failure ends as one line ``error: ...`` on stderr and an exit code of
:mod:`warp_caustics.errors`. A failure nobody foresaw also leaves its traceback
in a file. Nothing heavy is imported here nor at the top of a command's module,
so that ``nsfc --help`` answers at once.
"""

import atexit
import importlib
import os
import signal
import sys
from collections.abc import Sequence

import rich_click as click

from cli.failures import explained
from cli.garbage import left_to_the_system
from warp_caustics.errors import EXIT_INTERRUPTED, EXIT_TERMINATED, EXIT_USAGE, known_names
from warp_caustics.signals import Restore, answered

# Threads that have nothing to do sleep; to be said before torch is loaded. By default they keep their cores busy, and
# where others work, or threads are more than cores, each small operation takes as long as the system lets others run.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

# NumPy's BLAS has threads of its own, which keep trying while they wait. All that is large here is done by torch and
# Warp; of what is left to NumPy, 100 x 4096 times 4096 x 100 numbers take one thread 2 ms, and two threads, where
# others work, 130 ms and more.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Registered first, so that it comes after all that modules do as a process ends.
atexit.register(left_to_the_system)

COMMANDS = {
    "reconstruct": "cli.reconstruct:reconstruct",
    "inspect": "cli.inspect:inspect",
    "compare": "cli.compare:compare",
    "bench": "cli.bench:bench",
    "plan": "cli.plan:plan",
    "setup": "cli.setup_cmd:setup",
    "calibrate": "cli.calibrate:calibrate",
    "simulate": "cli.simulate:simulate",
    "capture": "cli.capture:capture",
    "design": "cli.design:design",
    "train": "cli.train:train",
    "search": "cli.search:search",
    "weights": "cli.weights:weights",
    "data": "cli.data:data",
    "config": "cli.config_cmd:config",
    "env": "cli.env:env",
}


class Terminated(BaseException):
    """SIGTERM arrived. Not an Exception: nothing but clean-up code may hold it up."""


class LazyGroup(click.RichGroup):
    """Group that imports a command's module when the command is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all commands, in the order of the help page."""
        return list(COMMANDS)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that the arguments begin with; a wrong one is answered with the likely right one."""
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            ctx.fail(f"No such command {args[0][:60]!r}; {known_names(args[0], COMMANDS)}")
        return super().resolve_command(ctx, args)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, imported now."""
        if cmd_name not in COMMANDS:
            return None
        module, attribute = COMMANDS[cmd_name].split(":")
        command: click.Command = getattr(importlib.import_module(module), attribute)
        return command


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="nsfc", message="nsfc %(version)s")
def nsfc() -> None:
    """Shape from caustics: recover the printed height field of a glass plate from one caustic image."""


def main(args: Sequence[str] | None = None) -> int:
    """Run ``nsfc``.

    Args:
        args: arguments without the program's name; those of the process if None.

    Returns:
        The exit code.
    """
    try:
        _accept_any_name()
        with answered(_terminate, signal.SIGTERM):
            # Commands return an exit code, or None for success.
            result = nsfc.main(args, prog_name="nsfc", standalone_mode=False)
        return result if isinstance(result, int) else 0
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else "nsfc"
        return _report(f"{error.format_message().rstrip('.')}; see {where} --help", EXIT_USAGE)
    except click.ClickException as error:
        return _report(error.format_message(), EXIT_USAGE)
    except (click.Abort, KeyboardInterrupt):
        return _report("interrupted", EXIT_INTERRUPTED)
    except Terminated:
        return _report("terminated", EXIT_TERMINATED)
    except Exception as error:
        message, code = explained(error)
        return _report(message, code)


def _accept_any_name() -> None:
    """Print names that the terminal's encoding does not have with backslashes, instead of failing after the work."""
    for stream in (sys.stdout, sys.stderr):
        if getattr(stream, "errors", None) == "strict" and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _terminate(number: int, restore: Restore) -> None:
    restore()  # A second one ends the process at once.
    raise Terminated


def _report(message: str, code: int) -> int:
    click.echo(f"error: {' '.join(message.split())}", err=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
