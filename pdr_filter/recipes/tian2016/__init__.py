"""Parts of the recipe of Tian et al. 2016."""
