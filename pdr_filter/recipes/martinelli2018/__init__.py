"""Parts of the recipe of Martinelli et al. 2018."""
