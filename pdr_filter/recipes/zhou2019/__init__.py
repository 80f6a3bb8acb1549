"""Parts of Zhou et al. 2019."""
