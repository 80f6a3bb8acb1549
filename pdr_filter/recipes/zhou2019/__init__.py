"""Parts of the recipe of Zhou et al. 2019."""
