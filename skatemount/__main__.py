"""`python -m skatemount`: which programs there are."""

print(
    "skatemount is used through its programs:\n"
    "  python -m skatemount.train stage=balance                    train a stage (without one: which there are)\n"
    "  python -m skatemount.evaluate checkpoint=pretrained:balance  how often a policy succeeds\n"
    "  python -m skatemount.record checkpoint=pretrained:balance    film it\n"
    "  python -m skatemount.bench stage=balance                    how fast training is here\n"
    "Settings: --cfg job prints them all."
)
