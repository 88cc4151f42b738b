"""Observation terms, and the table that concatenates them into one vector."""

from skatemount.envs.config.terms import ObservationTerm
from skatemount.envs.observations import terms
from skatemount.envs.observations.table import OBSERVATIONS, ObservationTable, TermLayout, observation

__all__ = ["OBSERVATIONS", "ObservationTable", "ObservationTerm", "TermLayout", "observation", "terms"]
