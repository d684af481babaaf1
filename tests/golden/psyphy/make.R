# Golden values of d': Rscript make.R > d_prime.csv
library(psyphy)

rates <- expand.grid(FA = c(0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9), H = c(0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 0.999))
rates <- rates[rates$H > rates$FA, ]
cat("task,rule,hit,false_alarm,d_prime\n")
row <- function(task, rule, h, f, d) cat(sprintf("%s,%s,%.17g,%.17g,%.17g\n", task, rule, h, f, d))
for (i in seq_len(nrow(rates))) {
  h <- rates$H[i]
  f <- rates$FA[i]
  row("same-different", "differencing", h, f, dprime.SD(H = h, FA = f, method = "diff"))
  row("same-different", "independent-observations", h, f, dprime.SD(H = h, FA = f, method = "IO"))
  row("abx", "differencing", h, f, dprime.ABX(Hits = h, FA = f, method = "diff"))
  row("abx", "independent-observations", h, f, dprime.ABX(Hits = h, FA = f, method = "IO"))
}
