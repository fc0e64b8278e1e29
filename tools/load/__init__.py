"""What something beside the modules costs them: the logger, the operator's page, clients of Foxglove."""
