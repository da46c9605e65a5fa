"""Effects that a backend adds to itself, for backends; see :mod:`s2r_spec.backend.effects`."""

from s2r_spec.backend.effects import Change as Change
from s2r_spec.backend.effects import Choice as Choice
from s2r_spec.backend.effects import ModelEffect as ModelEffect
from s2r_spec.backend.effects import Values as Values
from s2r_spec.backend.effects import add_effects as add_effects
from s2r_spec.backend.effects import adds as adds
from s2r_spec.backend.effects import as_values as as_values
from s2r_spec.backend.effects import catalogue_of as catalogue_of
from s2r_spec.backend.effects import choose as choose
from s2r_spec.backend.effects import limits as limits
from s2r_spec.backend.effects import prior_scale as prior_scale
from s2r_spec.backend.effects import read_word as read_word
from s2r_spec.backend.effects import scales as scales
from s2r_spec.backend.effects import sets as sets
from s2r_spec.backend.effects import settings as settings
from s2r_spec.backend.effects import with_prior_scale as with_prior_scale
from s2r_spec.backend.effects import words as words
from s2r_spec.backend.options import read_options as read_options
