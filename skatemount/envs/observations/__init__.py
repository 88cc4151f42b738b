"""Observation terms and the table that puts them into one vector."""

from skatemount.envs.config.terms import ObservationTerm
from skatemount.envs.observations import terms
from skatemount.envs.observations.table import OBSERVATIONS, Layout, ObservationTable

__all__ = ["OBSERVATIONS", "Layout", "ObservationTable", "ObservationTerm", "terms"]
