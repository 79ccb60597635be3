"""What --methods and --iterations mean."""

import pytest

from nets.evaluation.method_spec import parse_budgets, parse_methods
from warp_caustics.errors import InputError


def test_settings_belong_to_the_method_before_them():
    specs = parse_methods(
        ["flat,sfc:variant=landweber_wavelet,mask=oracle,transport+refine", "direct:symmetries=false"]
    )
    assert [spec.label for spec in specs] == [
        "flat", "sfc:variant=landweber_wavelet,mask=oracle", "transport+refine", "direct:symmetries=false",
    ]  # fmt: skip
    assert dict(specs[1].stages[0].options) == {"variant": "landweber_wavelet", "mask": "oracle"}
    assert specs[1].stages[0].wants_truth and not specs[0].stages[0].wants_truth
    assert [stage.name for stage in specs[2].stages] == ["transport", "refine"]
    assert dict(specs[3].stages[0].options) == {"symmetries": False}


def test_values_are_numbers_words_or_text():
    (spec,) = parse_methods(["transport:cells=64+refine:step_m=1e+3,metric=height,discrepancy=null,bare_fraction=0.5"])
    assert [dict(stage.options) for stage in spec.stages] == [
        {"cells": 64}, {"step_m": 1000.0, "metric": "height", "discrepancy": None, "bare_fraction": 0.5},
    ]  # fmt: skip


def test_the_last_stage_is_limited():
    (spec,) = parse_methods(["transport+refine:metric=height"])
    limited = spec.limited("5")
    assert dict(limited.stages[1].options) == {"metric": "height", "max_iterations": 5}
    assert limited.stages[0] == spec.stages[0] and limited.label == spec.label
    assert spec.limited("converged") == spec


def test_methods_without_iterations_have_one_column():
    wanted = ("1", "converged")
    columns = {spec.label: spec.budgets(wanted) for spec in parse_methods(["flat,transport,refine,refine+transport"])}
    assert columns == {
        "flat": ("once",), "transport": ("once",), "refine": wanted, "refine+transport": ("once",),
    }  # fmt: skip
    (fixed,) = parse_methods(["refine:max_iterations=7"])
    assert fixed.budgets(wanted) == ("once",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no method given"),
        ("mask=oracle,sfc", "begins with the setting 'mask=oracle'"),
        ("refine,refine", "given twice"),
        ("sfc:mask", "is not KEY=VALUE"),
        ("sfc:mask=", "is not KEY=VALUE"),
        ("sfc:mask=none,mask=oracle", "sets mask twice"),
        (":mask=none", "stage without a name"),
        ("flat:height=1", "flat guess has no settings"),
    ],
)
def test_misspelled_methods_are_explained(text, message):
    with pytest.raises(InputError, match=message):
        parse_methods([text])


def test_budgets():
    assert parse_budgets("1, 010,converged") == ("1", "10", "converged")
    for wrong in ("0", "-1", "1.5", "all", "", "1,1", "1,01"):
        with pytest.raises(InputError, match="--iterations"):
            parse_budgets(wrong)
