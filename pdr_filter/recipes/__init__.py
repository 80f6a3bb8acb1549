"""Recipes: functions that return a configuration. `default` is the one to use; the others are published systems.

Each function has the name of the module or sub-package that holds its parts, and is imported here so that
`pdr_filter.recipes.martinelli2018` is the function.
"""

from pdr_filter.recipes.default import RECIPES as RECIPES
from pdr_filter.recipes.default import attitude_free_contexts as attitude_free_contexts
from pdr_filter.recipes.default import check_name as check_name
from pdr_filter.recipes.default import context_modes as context_modes
from pdr_filter.recipes.default import context_transitions as context_transitions
from pdr_filter.recipes.default import contexts_of as contexts_of
from pdr_filter.recipes.default import default as default
from pdr_filter.recipes.default import for_recording as for_recording
from pdr_filter.recipes.default import guo2018 as guo2018
from pdr_filter.recipes.default import martinelli2018 as martinelli2018
from pdr_filter.recipes.default import susi2013 as susi2013
from pdr_filter.recipes.default import tian2016 as tian2016
from pdr_filter.recipes.default import with_context_model as with_context_model
from pdr_filter.recipes.default import with_transitions as with_transitions
from pdr_filter.recipes.default import zhou2019 as zhou2019
from pdr_filter.values.recording import Subject as Subject
