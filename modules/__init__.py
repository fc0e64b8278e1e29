"""The stock robot's modules: thin glue between messages and devices or workers."""
