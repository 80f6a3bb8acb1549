"""Parts of Tian et al. 2016."""
