"""The docstrings of all public names by numpydoc's validation: run by `make site-test`, as numpydoc is installed there.

Functions, classes and the methods that users call have sections: Parameters, Returns, Raises, Examples.
"""

import inspect

import pytest
from numpydoc.docscrape import ClassDoc
from numpydoc.validate import ERROR_MSGS, validate
from pages import INNER

import mpt_helpers as mpt

# The rules of numpydoc that are not asked for, and why.
OFF = {
    "GL01": "a text begins in the line of the quotes: ruff's D212",
    "GL02": "a blank line stands after the last section: ruff's D413",
    "GL03": "as above",
    "ES01": "one line may say all",
    "PR08": "a description may begin with a symbol, as x(k/k)",
    "RT04": "as above",
    "SS05": "a summary says what is returned, and need not begin with a verb",
    "SA01": "the text names what else there is to see",
    "YD01": "no public function yields",
}


def public():
    """Return each public function and class by its full name, and the methods of these where they are first defined."""
    found = {}
    for name in mpt.__all__:
        whole = getattr(mpt, name)
        for each in [getattr(whole, inner) for inner in whole.__all__] if inspect.ismodule(whole) else [whole]:
            found[f"{each.__module__}.{each.__qualname__}"] = each
            for method in dir(each) if inspect.isclass(each) else ():
                owner = next((base for base in reversed(each.__mro__) if method in vars(base)), None)
                of_ours = owner is not None and owner.__module__.startswith("mpt_helpers")
                if of_ours and not method.startswith("_") and method not in INNER:
                    value = vars(owner)[method]
                    if isinstance(value, property | classmethod | staticmethod) or inspect.isfunction(value):
                        found[f"{owner.__module__}.{owner.__qualname__}.{method}"] = value
    return found


PUBLIC = public()
RESULTS = [each for each in PUBLIC.values() if inspect.isclass(each) and "Attributes\n" in (each.__doc__ or "")]
RESULTS = [each for each in RESULTS if "Parameters\n" not in each.__doc__]


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_a_docstring_is_valid(name):
    """By the rules of numpydoc that are not off."""
    each = PUBLIC[name]
    off = set(OFF)
    if each in RESULTS:  # which users do not make
        off |= {"PR01", "EX01"}
    if name.count(".") > name.count("mpt_helpers.tracks") + 2 and not inspect.isclass(each):  # the class has an example
        off.add("EX01")
    errors = [f"{code}: {text}" for code, text in validate(name)["errors"] if code in ERROR_MSGS.keys() - off]
    assert errors == []


@pytest.mark.parametrize("method", ["filter", "estimates", "covariances", "smooth", "step"])
@pytest.mark.parametrize("each", [mpt.KalmanFilter, mpt.LainiotisFilter, mpt.SteadyStateFilter])
def test_help_of_a_filter_shows_the_docstring_of_the_base_class(each, method):
    """One text for all filters: a method without a docstring inherits it."""
    (base,) = {inspect.getdoc(getattr(one, method)) for one in each.__mro__ if hasattr(one, method)}
    assert "Returns\n-------" in base


@pytest.mark.parametrize("result", RESULTS, ids=lambda each: each.__name__)
def test_each_field_of_a_result_is_described(result):
    """Not as "Alias for field number 0"."""
    described = [name for entry in ClassDoc(result)["Attributes"] for name in entry.name.split(", ")]
    assert set(result.__annotations__) <= set(described)


def test_public_names_are_found():
    """A test of nothing would pass, too."""
    assert len(RESULTS) >= 7
    assert len(PUBLIC) > 80
