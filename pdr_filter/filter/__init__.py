"""Filter that turns steps, context windows and fixes into track rows with covariances."""
