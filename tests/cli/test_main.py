"""Exit codes and one-line errors; through the installed script where the process is what is tested."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rich_click as click

from cli import main as main_module
from warp_caustics.errors import DamagedDataError

SCRIPT = Path(sys.executable).with_name("nsfc")


def script(*arguments):
    """Runs the installed script in a process of its own."""
    return subprocess.run([SCRIPT, *map(str, arguments)], capture_output=True, text=True)


@pytest.fixture
def refused(capfd):
    """Runs a command here; checks its exit code and that it said one line on stderr, nothing else."""

    def refused(code, reason, *arguments):
        found = main_module.main([*map(str, arguments)])
        out, err = capfd.readouterr()
        assert found == code, err
        assert_one_line(out, err, reason)

    return refused


def assert_one_line(out, err, reason):
    assert out == ""
    assert err.startswith("error: ") and err.count("\n") == 1, err
    assert reason in err


def test_0_version():
    run = script("--version")
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.startswith("nsfc 0.")


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["simulat"], "see nsfc --help"),
        (["simulate"], "Missing argument 'HEIGHTS'; see nsfc simulate --help"),
        (["simulate", "h.npy", "-o", "x.tif", "--seed", "1.5"], "'1.5' is not a whole number"),
        (["config", "show", "--frob"], "--frob"),
    ],
)
def test_2_usage(refused, arguments, reason):
    refused(2, reason, *arguments)


def test_3_bad_input():
    """The code of the process is that of the error."""
    run = script("config", "show", "paper", "--set", "scene.image_pixls=3")
    assert run.returncode == 3
    assert_one_line(run.stdout, run.stderr, "did you mean 'image_pixels'")


def test_4_damaged_data(tmp_path, inputs, refused):
    content = (inputs / "image.tif").read_bytes()
    (tmp_path / "image.tif").write_bytes(content[: len(content) // 2])
    refused(4, "image.tif", "reconstruct", tmp_path / "image.tif", "-o", tmp_path / "out", "--config", "small")


def test_5_things_that_do_not_belong_together(tmp_path, inputs, refused):
    refused(5, "128 x 128", "reconstruct", inputs / "image.tif", "-o", tmp_path / "out")


def test_6_missing_device(tmp_path, inputs, refused):
    arguments = "simulate", inputs / "heights.npy", "-o", tmp_path / "out.tif", "--config", "small"
    refused(6, "cuda:99", *arguments, "--device", "cuda:99")


def test_output_folder_may_be_anywhere(tmp_path, inputs, monkeypatch, capfd):
    """From another working directory, with relative paths and a config by name."""
    monkeypatch.chdir(tmp_path)
    arguments = "simulate", inputs / "heights.npy", "-o", "out.npy", "--config", "small", "--device", "cpu"
    assert main_module.main([*map(str, arguments)]) == 0
    assert capfd.readouterr().err == ""
    assert np.load(tmp_path / "out.npy").shape == (3, 128, 128)


@pytest.mark.parametrize(
    ("number", "code", "last"),
    [(signal.SIGINT, 130, "the best result so far is in"), (signal.SIGTERM, 143, "terminated")],
)
def test_signals_are_orderly(tmp_path, inputs, number, code, last):
    """Ctrl-C while iterating writes the result; SIGTERM leaves nothing behind."""
    process = subprocess.Popen(
        [SCRIPT, "reconstruct", inputs / "image.tif", "-o", tmp_path / "out", "--config", "small", "--device", "cpu",
         "--set", "reconstruction.options.metric=height", "--max-iterations", "100000"],
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    try:
        line = ""
        while "level 1" not in line:  # iterating now
            line = process.stderr.readline()
            assert line, "ended before it was interrupted"
        process.send_signal(number)
        _, errors = process.communicate()
    finally:
        process.kill()
    assert process.returncode == code
    assert last in errors.splitlines()[-1]
    expected = ["out"] if number == signal.SIGINT else []
    assert sorted(os.listdir(tmp_path)) == expected
    if expected:
        assert json.loads((tmp_path / "out" / "result.json").read_text())["stop_reason"] == "interrupted"


@pytest.fixture
def failing(monkeypatch):
    """Turns a function into the command ``nsfc fail``."""

    def install(function):
        monkeypatch.setitem(main_module.COMMANDS, "fail", "cli.fake:fail")
        module = type(sys)("cli.fake")
        module.fail = click.command()(function)
        monkeypatch.setitem(sys.modules, "cli.fake", module)

    return install


def test_1_a_bug_leaves_its_traceback_in_a_file(failing, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    def fail():
        raise KeyError("a bug\nof two lines")

    failing(fail)
    assert main_module.main(["fail"]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "unexpected KeyError" in error
    (kept,) = tmp_path.iterdir()
    assert str(kept) in error
    assert "Traceback" in kept.read_text() and "test_main.py" in kept.read_text()


@pytest.mark.parametrize(
    ("raised", "code", "reason"),
    [
        (DamagedDataError("half a\n file"), 4, "error: half a file\n"),
        (MemoryError(), 6, "out of memory"),
        (RuntimeError("Failed to allocate 10 bytes on device 'cuda:0'"), 6, "out of memory"),
        (OSError(28, "No space left on device"), 6, "No space left on device; free space"),
        (OSError(27, "File too large"), 6, "File too large; raise the limit of file sizes (ulimit -f)"),
        (OSError(24, "Too many open files"), 6, "Too many open files; close files or raise the limit"),
        (OSError(36, "File name too long", "x" * 300), 3, "xxx...': File name too long; shorten the name"),
        (OSError(13, "Permission denied", b"a\xff"), 3, "'a\\udcff': Permission denied; choose a place"),
        (OSError(13, "Permission denied"), 1, "unexpected PermissionError"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (main_module.Terminated(), 143, "terminated"),
    ],
)
def test_errors_become_codes(failing, capsys, raised, code, reason):
    def fail():
        raise raised

    failing(fail)
    assert main_module.main(["fail"]) == code
    error = capsys.readouterr().err
    assert reason in error
    assert error.strip().count("\n") == 0


def test_validation_errors_become_one_line(failing, capsys):
    def fail():
        from warp_caustics.scene import Scene

        Scene(image_pixels=0, height_samples=0)

    failing(fail)
    assert main_module.main(["fail"]) == 3
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "image_pixels" in error and "height_samples" in error


def test_the_sigterm_handler_is_given_back():
    before = signal.getsignal(signal.SIGTERM)
    assert main_module.main(["--version"]) == 0
    assert signal.getsignal(signal.SIGTERM) is before


def test_env_names_versions_and_devices(capsys):
    assert main_module.main(["env", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["versions"]["python"] == ".".join(map(str, sys.version_info[:3]))
    assert found["versions"]["warp-lang"].startswith("1.")
    assert found["memory_bytes"] > 2**28 and found["cpu"]["cores"] >= 1
    assert main_module.main(["env"]) == 0
    assert found["kernel_cache"] in capsys.readouterr().out


def test_config_check_says_ok_or_why_not(capsys):
    assert main_module.main(["config", "check", "small"]) == 0
    assert "small: ok, 32^2 heights" in capsys.readouterr().out
    assert main_module.main(["config", "check", "small", "--set", "reconstruction.method=magic"]) == 3
    assert "magic" in capsys.readouterr().err
    assert main_module.main(["config", "check", "small", "--set", "reconstruction.options.no_such_option=1"]) == 3
    assert "no_such_option" in capsys.readouterr().err


def test_bad_configuration_is_found_before_anything_heavy_is_loaded():
    """Which makes the error quick."""
    code = (
        "import sys; from cli.main import main; code = main(sys.argv[1:]);"
        "print(sorted({'torch', 'warp', 'scipy', 'matplotlib', 'h5py', 'trimesh'} & set(sys.modules))); sys.exit(code)"
    )
    for command in (["simulate", "none.npy"], ["reconstruct", "none.tif"]):
        arguments = [*command, "-o", "x", "--set", "scene.image_pixels=0"]
        run = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True)
        assert (run.returncode, run.stdout) == (3, "[]\n"), run.stderr


@pytest.mark.parametrize(
    "arguments, guess",
    [
        (["reconstrct"], "did you mean 'reconstruct'?"),
        (["config", "show", "--set", "scene.image_pixel=3"], "did you mean 'image_pixels'?"),
        (["config", "show", "--set", "scene.glass=fused_silca"], "did you mean 'fused_silica'?"),
    ],
)
def test_a_name_that_is_nearly_right_is_guessed(arguments, guess, capsys):
    assert main_module.main(arguments) in (2, 3)
    assert guess in capsys.readouterr().err


def test_a_command_that_is_like_none_gets_the_list(capsys):
    assert main_module.main(["qqqqqq"]) == 2
    assert "use one of reconstruct, inspect" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "found"), [("nsfc tra", "train"), ("nsfc train de", "denoiser"), ("nsfc pl", "plan")]
)
def test_commands_and_values_complete(words, found, monkeypatch, capsys):
    monkeypatch.setenv("_NSFC_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    with pytest.raises(SystemExit):
        main_module.main([])
    assert f"plain,{found}" in capsys.readouterr().out.split()


def test_the_completion_script_is_printed(monkeypatch, capsys):
    monkeypatch.setenv("_NSFC_COMPLETE", "bash_source")
    with pytest.raises(SystemExit):
        main_module.main([])
    assert "complete -o nosort -F _nsfc_completion nsfc" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("OMP_WAIT_POLICY", None, "passive"),
        ("OMP_WAIT_POLICY", "active", "active"),
        ("OPENBLAS_NUM_THREADS", None, "1"),
        ("OPENBLAS_NUM_THREADS", "4", "4"),
    ],
)
def test_threads_that_wait_leave_cores_to_others(name, given, expected):
    """Unless somebody said otherwise; said before what has threads is loaded."""
    environment = {key: value for key, value in os.environ.items() if key != name}
    if given is not None:
        environment[name] = given
    code = f"import cli.main, os, sys; print(os.environ[{name!r}], 'torch' in sys.modules, 'numpy' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout.split() == [expected, "False", "False"]


def test_the_module_is_the_command():
    """It did nothing, without a word and with exit code 0."""
    done = subprocess.run([sys.executable, "-m", "cli.main", "nonsense"], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "No such command 'nonsense'" in done.stderr
