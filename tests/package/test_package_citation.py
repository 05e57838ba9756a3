"""CITATION.cff and the BibTeX of METHODS.md state this version, under its licence, with the paper of the method."""

from __future__ import annotations

import tomllib
from pathlib import Path

import yaml

import hapsim

REPOSITORY = Path(__file__).resolve().parents[2]


def test_a_citation_is_that_of_this_version() -> None:
    cited = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text("utf-8"))
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]
    page = (REPOSITORY / "hapsim" / "METHODS.md").read_text("utf-8")
    assert {"cff-version", "message", "title", "authors"} <= cited.keys()
    assert (cited["version"], cited["license"]) == (hapsim.__version__, project["license"])
    assert [one["name"] for one in cited["authors"]] == [one["name"] for one in project["authors"]]
    assert f"version = {{{hapsim.__version__}}}" in page
    (paper,) = cited["references"]
    authors = " and ".join(f"{one['family-names']}, {one['given-names']}" for one in paper["authors"])
    assert f"title  = {{{paper['title']}}}" in page
    assert f"author = {{{authors}}}" in page
