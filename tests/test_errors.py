"""Error messages of invalid input: complete, all together, with suggestions of similar names."""

import pytest

from wrapjax.errors import InputError, Problem, nearest_name


@pytest.mark.parametrize(
    ("problem", "sentence"),
    [
        (Problem("a.sto", "is empty"), "a.sto: is empty."),
        (Problem("a.sto", "is text", place="line 3"), "a.sto: line 3: is text."),
        (Problem("a.sto", "is text", hint="export it anew"), "a.sto: is text; export it anew."),
        # No full stop after a list that goes on.
        (
            Problem("--without", "is unknown", hint="known: a, b, ..."),
            "--without: is unknown; known: a, b, ...",
        ),
        # A question ends as one.
        (
            Problem("a.sto", "is unknown", place="column hip", hint="did you mean 'hip_l'?"),
            "a.sto: column hip: is unknown; did you mean 'hip_l'?",
        ),
    ],
)
def test_format_of_a_problem(problem, sentence):
    assert str(problem) == sentence


def test_input_error_has_all_problems_in_order():
    problems = [Problem("b", "is missing"), Problem("a", "is empty")]
    error = InputError(iter(problems))
    assert error.problems == tuple(problems)
    assert str(error) == "b: is missing.\na: is empty."


def test_input_error_takes_a_single_problem():
    problem = Problem("a", "is empty")
    assert InputError(problem).problems == (problem,)


def test_input_error_is_a_value_error():
    """So that scripts can catch it without importing the package."""
    with pytest.raises(ValueError, match="is empty"):
        raise InputError(Problem("a", "is empty"))


MUSCLES = ("soleus_l", "gasmed_l", "tibant_l")


@pytest.mark.parametrize(
    ("name", "meant"),
    [("soleus_r", "soleus_l"), ("Soleus_L", "soleus_l"), ("gasmedl", "gasmed_l"), ("TIBANT", "tibant_l")],
)
def test_a_similar_name_is_suggested(name, meant):
    assert nearest_name(name, MUSCLES) == f"did you mean '{meant}'?"


def test_suggestions_keep_the_spelling_of_known_names():
    assert nearest_name("recfem", ("RecFem",)) == "did you mean 'RecFem'?"


def test_known_names_are_listed_where_none_is_similar():
    assert nearest_name("xyz", MUSCLES) == "known: soleus_l, gasmed_l, tibant_l"


def test_long_lists_are_cut():
    known = [f"muscle_{number}" for number in range(9)]
    listed = nearest_name("xyz", known)
    assert listed.endswith("muscle_7, ...") and "muscle_8" not in listed
    assert not nearest_name("xyz", known[:8]).endswith("...")


def test_no_known_names():
    assert nearest_name("soleus_l", ()) == "none are known"
