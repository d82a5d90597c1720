# Installs the library and runs boundary.cpp as built by one compiler in all ways, with the installed
# libraries and with those of the other kind: what they print has to be the same.
# cmake -D library_build=… -D source=… -D scratch=… -D generator=… -D compiler=…
# -D other_libraries=… -D flags=… -D config=… -P …

# Runs a command. Its output is printed only if it fails: that of all builds would hide the cause.
function(run)
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE result OUTPUT_VARIABLE output
    ERROR_VARIABLE output)
  if(NOT result EQUAL 0)
    list(JOIN ARGN " " command)
    message("${output}")
    message(FATAL_ERROR "failed (${result}): ${command}")
  endif()
endfunction()

find_program(path_of_compiler ${compiler})
if(NOT path_of_compiler)
  if(DEFINED ENV{CI})
    message(FATAL_ERROR "${compiler} is not installed, and CI is set")
  endif()
  execute_process(COMMAND ${CMAKE_COMMAND} -E echo "skipped: ${compiler} is not installed")
  return()
endif()

file(REMOVE_RECURSE ${scratch})
run(${CMAKE_COMMAND} --install ${library_build} --prefix ${scratch}/prefix --config ${config})
run(${CMAKE_COMMAND} -S ${source} -B ${scratch}/build -G ${generator} -DBOUNDARY=ON
  "-DOTHER_LIBRARIES=${other_libraries}" -DCMAKE_PREFIX_PATH=${scratch}/prefix
  -DCMAKE_CXX_COMPILER=${path_of_compiler} -DCMAKE_CXX_FLAGS=${flags} -DCMAKE_BUILD_TYPE=None
  -DCMAKE_RUNTIME_OUTPUT_DIRECTORY=${scratch}/bin
  -DCMAKE_RUNTIME_OUTPUT_DIRECTORY_${config}=${scratch}/bin)
run(${CMAKE_COMMAND} --build ${scratch}/build --config ${config} --parallel 2)

file(READ ${scratch}/build/runnable.txt programs)
set(expected "")
foreach(program ${programs})
  execute_process(COMMAND ${scratch}/bin/${program} ${scratch}/files
    OUTPUT_VARIABLE printed ERROR_VARIABLE printed_too RESULT_VARIABLE result)
  if(NOT result EQUAL 0)
    message(FATAL_ERROR "${program} failed (${result}): ${printed_too}")
  endif()
  if(expected STREQUAL "")
    set(expected "${printed}")
  elseif(NOT printed STREQUAL expected)
    file(WRITE ${scratch}/expected.txt "${expected}")
    file(WRITE ${scratch}/printed.txt "${printed}")
    message(FATAL_ERROR "${program} prints something else: ${scratch}/expected.txt, printed.txt")
  endif()
  message(STATUS "${program}: the same")
endforeach()
