"""Pictures beside the depth, through the same lens: colour and near infrared, path traced or as a raster preview."""
