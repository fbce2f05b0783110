"""Model no more than a scene needs: error, held out or against truth, for each model with a choice of complexity."""
