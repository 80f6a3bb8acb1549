"""Parts of the recipe of Guo et al. 2018."""
