"""Parts of the recipe of Susi et al. 2013."""
