"""The live page: a policy acts while robot and board are pushed and conditions change."""
