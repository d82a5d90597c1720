# Makes a static library one object whose inner functions belong to it alone. Otherwise the linker
# takes each function of a template, those of Eigen and Ceres included, from the library or from the
# program: whichever it meets first. With -mavx2 in one of them, Eigen's memory and the alignment
# of Ceres' Jets differ, and the program crashes.
# cmake -D archive=… -D linker=… -D objcopy=… -D nm=… -D ar=… -P …

function(run)
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE result)
  if(NOT result EQUAL 0)
    list(JOIN ARGN " " command)
    message(FATAL_ERROR "failed (${result}): ${command}")
  endif()
endfunction()

set(object ${archive}.o)
run(${linker} -r --force-group-allocation --whole-archive ${archive} -o ${object})
# Variables that GCC makes unique in the process, whatever their visibility.
execute_process(COMMAND ${nm} ${object} OUTPUT_VARIABLE symbols RESULT_VARIABLE result)
if(NOT result EQUAL 0)
  message(FATAL_ERROR "failed (${result}): ${nm} ${object}")
endif()
string(REGEX MATCHALL "[0-9a-f]+ u [^\n]+" unique "${symbols}")
list(TRANSFORM unique REPLACE "^[0-9a-f]+ u " "")
list(JOIN unique "\n" unique)
file(WRITE ${object}.unique "${unique}\n")
run(${objcopy} --localize-hidden --weaken-symbols=${object}.unique ${object})
file(REMOVE ${archive} ${object}.unique)
run(${ar} qcs ${archive} ${object})
file(REMOVE ${object})
